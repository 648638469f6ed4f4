/* Prints the bytes of stack that calls of a controller need: each runs in a thread whose stack has been painted. */
#define _GNU_SOURCE /* pthread_attr_setstack */
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "trot.h"

enum { SIZE = 1 << 20, PAINT = 0xA5 };
static _Alignas(4096) unsigned char stack[SIZE];
static const double initial[TROT_NX] = {@INITIAL@};
static trot *controller;

static void *nothing(void *data) { return data; }

static void *reset(void *data)
{
    trot_reset(controller, initial, 0.0);
    return data;
}

/* Plans from states that are ever further off. */
static void *plan(void *data)
{
    double x[TROT_NX];
    trot_commands commands = {.set = TROT_SPEED | TROT_YAW_RATE, .speed = 0.8, .yaw_rate = 0.5};
    trot_command(controller, &commands);
    for (int k = 1; k <= 12; k++) {
        memcpy(x, initial, sizeof x);
        for (int i = 7; i < TROT_NX; i++) x[i] += 0.01 * k * (i % 3 - 1);
        trot_plan(controller, x, 0.02 * k);
    }
    return data;
}

static void *tick(void *data)
{
    double x[TROT_NX];
    trot_output output;
    for (int k = 0; k < 100; k++) {
        memcpy(x, initial, sizeof x);
        for (int i = 7; i < TROT_NX; i++) x[i] += 0.02 * k * (i % 3 - 1);
        trot_tick(controller, x, 0.24 + 0.002 * k, &output);
    }
    return data;
}

static long used(void *(*work)(void *))
{
    pthread_attr_t attributes;
    pthread_t thread;
    memset(stack, PAINT, sizeof stack);
    if (pthread_attr_init(&attributes) || pthread_attr_setstack(&attributes, stack, sizeof stack)) exit(2);
    if (pthread_create(&thread, &attributes, work, NULL) || pthread_join(thread, NULL)) exit(2);
    long free_bytes = 0;
    while (free_bytes < SIZE && stack[free_bytes] == PAINT) free_bytes++;
    return SIZE - free_bytes;
}

int main(void)
{
    const size_t size = trot_memory_size();
    void *memory = aligned_alloc(64, size);
    if (!(controller = trot_init(memory, size, NULL))) return 2;
    const long thread = used(nothing);
    const long by_reset = used(reset) - thread, by_plan = used(plan) - thread, by_tick = used(tick) - thread;
    printf("reset %ld, plan %ld, tick %ld\n", by_reset, by_plan, by_tick);
    free(memory);
    return 0;
}
