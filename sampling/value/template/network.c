/* Evaluates the value network in single precision, block by block of rows.

   All affine maps are folded into kernels and biases, see network.py. A layer is
       y = max(z + 1, exp(min(z, 0))),  z = (x kernel) * inverse + bias,
   with inverse = 1 / standard deviation of x's row (1 in the first layer). The kernel is such that the row's mean
   has no effect. Kernels are stored in tiles of TILE columns, each [row of the kernel][column of the tile]. */
#include <math.h>
#include <string.h>

#define LANES (2 * PIAFFE_W)
#define TILE (2 * LANES)
#define BLOCK 48 /* rows whose numbers fit in the processor's cache; a multiple of ROWS */

/* rows computed with each load from a kernel: as many as keep their sums in registers, of which there are 32 or 16 */
#if defined(__AVX512F__) || defined(__aarch64__)
#define ROWS 8
#define EACH_ROW(DO) DO(0) DO(1) DO(2) DO(3) DO(4) DO(5) DO(6) DO(7)
#else
#define ROWS 6
#define EACH_ROW(DO) DO(0) DO(1) DO(2) DO(3) DO(4) DO(5)
#endif

typedef float vec __attribute__((vector_size(4 * LANES), aligned(4)));
typedef int whole __attribute__((vector_size(4 * LANES)));

int piaffe_value_tile(void) { return TILE; }

static inline vec all(float a) { return a - (vec){0}; }

/* a where the mask is set, else b: C has no ?: for vectors */
static inline vec choose(whole mask, vec a, vec b) { return (vec)((mask & (whole)a) | (~mask & (whole)b)); }

/* exp of numbers that are not positive; exp_of(NaN) is NaN */
static inline vec exp_of(vec x)
{
    x = choose(x < -87.0f, all(-87.0f), x);
    const vec magic = all(12582912.0f); /* adding and subtracting it rounds to an integer */
    vec n = (x * 1.44269504088896341f + magic) - magic;
    vec r = (x - n * 0.693359375f) + n * 2.12194440e-4f;
    vec p = all(1.9875691500e-4f);
    p = p * r + 1.3981999507e-3f;
    p = p * r + 8.3334519073e-3f;
    p = p * r + 4.1665795894e-2f;
    p = p * r + 1.6666665459e-1f;
    p = p * r + 5.0000001201e-1f;
    p = p * r * r + r + 1.0f;
    whole power = (__builtin_convertvector(n, whole) + 127) << 23;
    return p * (vec)power;
}

static inline vec shifted_elu(vec z)
{
    vec e = exp_of(choose(z > 0.0f, all(0.0f), z)), up = z + 1.0f;
    return choose(e > up, e, up);
}

static inline float sum(vec v)
{
    float s = 0.0f;
    for (int l = 0; l < LANES; l++)
        s += v[l];
    return s;
}

/* The outputs of ROWS rows for one tile; adds the outputs to `total` and their squares to `square` */
static void tile(const float *x, int inputs, const float *kernel, const float *bias, const float *inverse, float *y,
                 int outputs, vec *total, vec *square)
{
#define BEGIN(i) vec a##i = {0}, b##i = {0};
    EACH_ROW(BEGIN)
    for (int k = 0; k < inputs; k++) {
        const vec p = *(const vec *)(kernel + k * TILE), q = *(const vec *)(kernel + k * TILE + LANES);
#define ADD(i)                                                                                                         \
    {                                                                                                                  \
        const vec s = all(x[i * inputs + k]);                                                                          \
        a##i += s * p;                                                                                                 \
        b##i += s * q;                                                                                                 \
    }
        EACH_ROW(ADD)
    }
    const vec p = *(const vec *)bias, q = *(const vec *)(bias + LANES);
#define END(i)                                                                                                         \
    a##i = shifted_elu(a##i * inverse[i] + p);                                                                         \
    b##i = shifted_elu(b##i * inverse[i] + q);                                                                         \
    *(vec *)(y + i * outputs) = a##i;                                                                                  \
    *(vec *)(y + i * outputs + LANES) = b##i;                                                                          \
    total[i] += a##i + b##i;                                                                                           \
    square[i] += a##i * a##i + b##i * b##i;
    EACH_ROW(END)
}

/* sizes: sizes of the inputs and of each hidden layer; work: 2 BLOCK times the largest of them */
void piaffe_value(const float *inputs, long rows, int layers, const int *sizes, float *const *kernels,
                  float *const *biases, const float *head, float head_bias, float epsilon, float *work, int largest,
                  float *values)
{
    for (long first = 0; first < rows; first += BLOCK) {
        const int count = rows - first < BLOCK ? (int)(rows - first) : BLOCK;
        const int padded = (count + ROWS - 1) / ROWS * ROWS;
        float *x = work, *y = work + (long)BLOCK * largest, inverse[BLOCK];
        memcpy(x, inputs + first * sizes[0], sizeof(float) * (size_t)count * (size_t)sizes[0]);
        memset(x + (long)count * sizes[0], 0, sizeof(float) * (size_t)(padded - count) * (size_t)sizes[0]);
        for (int i = 0; i < BLOCK; i++)
            inverse[i] = 1.0f;
        for (int layer = 0; layer < layers; layer++) {
            const int m = sizes[layer], n = sizes[layer + 1];
            vec total[BLOCK], square[BLOCK];
            memset(total, 0, sizeof total);
            memset(square, 0, sizeof square);
            for (int column = 0; column < n; column += TILE)
                for (int i = 0; i < padded; i += ROWS)
                    tile(x + (long)i * m, m, kernels[layer] + (long)column * m, biases[layer] + column, inverse + i,
                         y + (long)i * n + column, n, total + i, square + i);
            for (int i = 0; i < padded; i++) {
                const float mean = sum(total[i]) / (float)n, variance = sum(square[i]) / (float)n - mean * mean;
                inverse[i] = 1.0f / sqrtf((variance < 0.0f ? 0.0f : variance) + epsilon);
            }
            float *swap = x;
            x = y;
            y = swap;
        }
        const int m = sizes[layers];
        for (int i = 0; i < count; i++) {
            vec dot = {0};
            for (int k = 0; k < m; k += LANES)
                dot += *(const vec *)(x + (long)i * m + k) * *(const vec *)(head + k);
            const float v = sum(dot) * inverse[i] + head_bias;
            values[first + i] = (v > 0.0f ? v : 0.0f) + log1pf(expf(-fabsf(v)));
        }
    }
}
