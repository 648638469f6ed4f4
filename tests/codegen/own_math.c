/* Values of the functions of own_math.h and of libm at points of standard input: lines of a name, x and y. */
#include <math.h>
#include <stdio.h>
#include <string.h>

static double theirs(const char *name, double x, double y)
{
#define CASE(f, call) if (!strcmp(name, f)) return call
    CASE("sin", sin(x)); CASE("cos", cos(x)); CASE("tan", tan(x)); CASE("asin", asin(x)); CASE("acos", acos(x));
    CASE("atan", atan(x)); CASE("atan2", atan2(y, x)); CASE("exp", exp(x)); CASE("log", log(x)); CASE("pow", pow(x, y));
    CASE("hypot", hypot(x, y)); CASE("log1p", log1p(x)); CASE("expm1", expm1(x)); CASE("sinh", sinh(x)); CASE("cosh", cosh(x));
    CASE("tanh", tanh(x)); CASE("asinh", asinh(x)); CASE("acosh", acosh(x)); CASE("atanh", atanh(x)); CASE("erf", erf(x));
    return NAN;
}

#include "own_math.h"

static double ours(const char *name, double x, double y)
{
    CASE("sin", sin(x)); CASE("cos", cos(x)); CASE("tan", tan(x)); CASE("asin", asin(x)); CASE("acos", acos(x));
    CASE("atan", atan(x)); CASE("atan2", atan2(y, x)); CASE("exp", exp(x)); CASE("log", log(x)); CASE("pow", pow(x, y));
    CASE("hypot", hypot(x, y)); CASE("log1p", log1p(x)); CASE("expm1", expm1(x)); CASE("sinh", sinh(x)); CASE("cosh", cosh(x));
    CASE("tanh", tanh(x)); CASE("asinh", asinh(x)); CASE("acosh", acosh(x)); CASE("atanh", atanh(x)); CASE("erf", erf(x));
    return NAN;
}

int main(void)
{
    char name[16];
    double x, y;
    while (scanf("%15s %lf %lf", name, &x, &y) == 3) printf("%.17g %.17g\n", ours(name, x, y), theirs(name, x, y));
    return 0;
}
