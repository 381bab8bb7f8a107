/* bench.h - what benches share: a clock, a median, the end of a run that fails, the compiler's flags. */
#ifndef SFEM_BENCH_H
#define SFEM_BENCH_H

#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include "softfem.h"

#ifndef SFEM_BENCH_FLAGS
#define SFEM_BENCH_FLAGS "not stated"
#endif
#define BENCH_STATIC static __attribute__((unused))

/* Seconds of the processor by this process: others may be at work on the machine. */
BENCH_STATIC double bench_seconds(void)
{
    struct timespec t;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

BENCH_STATIC int bench_compare(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* Sorts them. */
BENCH_STATIC double bench_median(double *value, int count)
{
    qsort(value, (size_t)count, sizeof *value, bench_compare);
    return count ? value[count / 2] : 0;
}

BENCH_STATIC void bench_must(sfem_status status, const sfem_error *err)
{
    if (status == SFEM_OK) return;
    fflush(stdout);
    fprintf(stderr, "%s\n", err->text);
    exit(2);
}

#endif
