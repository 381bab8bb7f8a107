/* support.h - what the tests share. Include it first: it asks for POSIX, and includes softfem.h.
 * A test of private functions defines SFEM_STATIC and SOFTFEM_IMPLEMENTATION before it; misuse then
 * trips cmocka's mock_assert, which expect_assert_failure sees.
 *
 *     assert_near(a, b, rtol, atol)     |a - b| <= atol + rtol max(|a|,|b|), in double; prints both
 *     assert_ok(call, err)              call returns SFEM_OK, or its error text is printed
 *     assert_status(call, wanted)       call returns that status
 *     test_memory, test_allocator       counts blocks, fails the Nth allocation, finds leaks
 *     fail_every_allocation(f, user)    f with its 1st, 2nd, ... allocation failing, till none does
 *     hash_reals(x, n)                  equal bits, equal hash
 *     test_random, random_*             repeatable numbers
 *     exact_body_def()                  the default body with handles that do not yield
 *     mesh_bandwidth(mesh)              largest difference of two node numbers in one tet
 *     thread_exec(n)                    an sfem_exec on n POSIX threads
 *     mesh_path(name), scratch_path(name)   a mesh from SFEM_MESHES, or NULL; a file to write
 *     run_all_tests(tests)              main's last line; SFEM_FILTER=PATTERN picks tests
 */
#ifndef SFEM_TESTS_SUPPORT_H
#define SFEM_TESTS_SUPPORT_H

#ifndef _POSIX_C_SOURCE
#define _POSIX_C_SOURCE 200809L
#endif
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>
#include <math.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#ifndef SFEM_ASSERT
#define SFEM_ASSERT(x) mock_assert((x) ? 1 : 0, #x, __FILE__, __LINE__)
#endif
#include "softfem.h"

#define TEST_STATIC       static __attribute__((unused))
#define TEST_COUNT(array) (sizeof(array) / sizeof *(array))
#define TEST_PI           3.14159265358979323846

/* Sanitizers make everything five times as slow: they look for faults of memory, which few of many like runs show. */
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
#define TEST_SANITIZED 1
#else
#define TEST_SANITIZED 0
#endif

#ifndef SFEM_NO_BODY
/* The default, with handles that are constraints. */
TEST_STATIC sfem_body_def exact_body_def(void)
{
    sfem_body_def def = sfem_default_body_def();
    def.handle_compliance = 0;
    return def;
}
#endif

/* The largest difference of two node numbers in one tet. */
TEST_STATIC sfem_int mesh_bandwidth(const sfem_mesh *mesh)
{
    sfem_int t, width = 0;
    int i;
    for (t = 0; t < mesh->tets; ++t) {
        const sfem_int *v = mesh->tet + 4 * (size_t)t;
        sfem_int low = v[0], high = v[0];
        for (i = 1; i < 4; ++i) {
            if (v[i] < low) low = v[i];
            if (v[i] > high) high = v[i];
        }
        if (high - low > width) width = high - low;
    }
    return width;
}

/* --------------------------------------------------------------------------------------------
 * assertions
 * -------------------------------------------------------------------------------------------- */

TEST_STATIC void test_near(double a, double b, double rtol, double atol, const char *a_text,
                           const char *b_text, const char *file, int line)
{
    const double size = fabs(a) > fabs(b) ? fabs(a) : fabs(b);
    const double difference = fabs(a - b);
    const double allowed = atol + rtol * size;
    if (difference <= allowed) return; /* false for NaN */
    print_error("%s = %.17g\n%s = %.17g\ndifference %.3g, relative %.3g, allowed %.3g\n", a_text, a,
                b_text, b, difference, size > 0 ? difference / size : 0.0, allowed);
    _fail(file, line);
}

#define assert_near(a, b, rtol, atol)                                                              \
    test_near((double)(a), (double)(b), (rtol), (atol), #a, #b, __FILE__, __LINE__)

/* the values of two blocks; the tolerance is relative to the largest of them */
TEST_STATIC void test_all_near(const double *a, const double *b, size_t count, double rtol,
                               double atol, const char *a_text, const char *b_text,
                               const char *file, int line)
{
    double size = 0;
    size_t i;
    char text[64];
    for (i = 0; i < count; ++i) size = fmax(size, fmax(fabs(a[i]), fabs(b[i])));
    for (i = 0; i < count; ++i) {
        if (fabs(a[i] - b[i]) <= atol + rtol * size) continue;
        snprintf(text, sizeof text, "%.40s[%lu]", a_text, (unsigned long)i);
        test_near(a[i], b[i], 0, atol + rtol * size, text, b_text, file, line);
    }
}

#define assert_all_near(a, b, count, rtol, atol)                                                   \
    test_all_near((a), (b), (size_t)(count), (rtol), (atol), #a, #b, __FILE__, __LINE__)

TEST_STATIC void test_ok(sfem_status status, const char *text, const char *call, const char *file,
                         int line)
{
    if (status == SFEM_OK) return;
    print_error("%s\nreturned \"%s\": %s\n", call, sfem_status_text(status), text);
    _fail(file, line);
}

#define assert_ok(call, err)                                                                       \
    do {                                                                                           \
        const sfem_status test_status_ = (call); /* before err.text is read */                     \
        test_ok(test_status_, (err).text, #call, __FILE__, __LINE__);                              \
    } while (0)

TEST_STATIC void test_status(sfem_status status, sfem_status wanted, const char *call,
                             const char *file, int line)
{
    if (status == wanted) return;
    print_error("%s\nreturned \"%s\", wanted \"%s\"\n", call, sfem_status_text(status),
                sfem_status_text(wanted));
    _fail(file, line);
}

#define assert_status(call, wanted) test_status((call), (wanted), #call, __FILE__, __LINE__)

/* the error names the thing: its text contains the given words */
#define assert_names(err, words)                                                                   \
    do {                                                                                           \
        if (!strstr((err).text, (words)))                                                          \
            fail_msg("\"%s\" does not name \"%s\"", (err).text, (words));                          \
    } while (0)

/* --------------------------------------------------------------------------------------------
 * memory: an allocator that counts, and that fails when told
 * -------------------------------------------------------------------------------------------- */

typedef struct test_memory {
    size_t calls;                /* allocations asked for */
    size_t live, bytes;          /* blocks, and bytes in them, not yet released */
    size_t peak;                 /* most bytes at any time */
    size_t fail_at, fail_always; /* fail the fail_at'th call (0: none), and all after it */
    size_t refused;              /* calls that were made to fail */
} test_memory;

typedef struct test_block {
    size_t bytes;
    uint64_t mark; /* 16 bytes in all: malloc's alignment is kept */
} test_block;

#define TEST_MARK 0x5af7fe3b10c5a11eu

TEST_STATIC void *test_allocate(size_t bytes, void *user)
{
    test_memory *m = (test_memory *)user;
    test_block *block;
    ++m->calls;
    if (m->fail_at && (m->calls == m->fail_at || (m->fail_always && m->calls > m->fail_at))) {
        ++m->refused;
        return NULL;
    }
    block = (test_block *)malloc(sizeof *block + bytes);
    if (!block) return NULL;
    block->bytes = bytes;
    block->mark = TEST_MARK;
    memset(block + 1, 0xa5, bytes); /* not zero: who relies on that is found out */
    ++m->live;
    m->bytes += bytes;
    if (m->bytes > m->peak) m->peak = m->bytes;
    return block + 1;
}

TEST_STATIC void test_release(void *memory, void *user)
{
    test_memory *m = (test_memory *)user;
    test_block *block = (test_block *)memory - 1;
    if (!memory || block->mark != TEST_MARK) {
        print_error("released what was not allocated, or twice\n");
        abort();
    }
    --m->live;
    m->bytes -= block->bytes;
    block->mark = 0;
    memset(memory, 0x5a, block->bytes);
    free(block);
}

TEST_STATIC sfem_allocator test_allocator(test_memory *m)
{
    sfem_allocator a;
    a.allocate = test_allocate;
    a.release = test_release;
    a.user = m;
    return a;
}

#define assert_no_leak(m) assert_int_equal((m).live, 0)

/* Does something with the allocator, frees all of it whatever happened, returns the first status
 * that was not SFEM_OK. */
typedef sfem_status (*test_attempt)(sfem_allocator allocator, void *user, sfem_error *err);

/* Runs the attempt with its Nth allocation failing, N = 1, 2, ... until it succeeds; then once more
 * with all from the Nth on failing. Each time it must return SFEM_OUT_OF_MEMORY with a text, and
 * leave no block behind. Returns the number of allocations of the attempt that succeeds. */
TEST_STATIC size_t fail_every_allocation(test_attempt attempt, void *user)
{
    size_t always, n, calls = 0;
    for (always = 0; always < 2; ++always) {
        for (n = 1;; ++n) {
            test_memory memory = {0};
            sfem_error err = {SFEM_OK, -1, -1, -1, ""};
            sfem_status status;
            memory.fail_at = n;
            memory.fail_always = always;
            status = attempt(test_allocator(&memory), user, &err);
            if (memory.live)
                fail_msg("allocation %lu failed: %lu blocks left", (unsigned long)n,
                         (unsigned long)memory.live);
            calls = memory.calls;
            if (!memory.refused) {
                test_ok(status, err.text, "with every allocation granted", __FILE__, __LINE__);
                break;
            }
            if (status != SFEM_OUT_OF_MEMORY || !err.text[0])
                fail_msg("allocation %lu failed: status \"%s\", text \"%s\"", (unsigned long)n,
                         sfem_status_text(status), err.text);
        }
    }
    return calls;
}

/* --------------------------------------------------------------------------------------------
 * hash, random numbers
 * -------------------------------------------------------------------------------------------- */

TEST_STATIC uint64_t hash_bytes(const void *data, size_t bytes) /* FNV-1a */
{
    const unsigned char *c = (const unsigned char *)data;
    uint64_t h = 0xcbf29ce484222325u;
    size_t i;
    for (i = 0; i < bytes; ++i) h = (h ^ c[i]) * 0x100000001b3u;
    return h;
}

TEST_STATIC uint64_t hash_reals(const sfem_real *x, size_t count)
{
    return hash_bytes(x, count * sizeof *x);
}

typedef struct test_random {
    uint64_t state; /* the seed; any number */
} test_random;

TEST_STATIC uint64_t random_bits(test_random *r) /* splitmix64 [Steele, Lea, Flood 2014] */
{
    uint64_t z = (r->state += 0x9e3779b97f4a7c15u);
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
    return z ^ (z >> 31);
}

TEST_STATIC double random_uniform(test_random *r, double low, double high)
{
    return low + (high - low) * ((double)(random_bits(r) >> 11) / 9007199254740992.0);
}

TEST_STATIC double random_normal(test_random *r) /* mean 0, variance 1 [Box, Muller 1958] */
{
    const double u = 1.0 - random_uniform(r, 0, 1), v = random_uniform(r, 0, 1);
    return sqrt(-2 * log(u)) * cos(2 * TEST_PI * v);
}

TEST_STATIC sfem_int random_below(test_random *r, sfem_int end)
{
    return (sfem_int)(random_bits(r) % (uint64_t)end);
}

TEST_STATIC void random_fill(test_random *r, sfem_real *x, size_t count, double low, double high)
{
    size_t i;
    for (i = 0; i < count; ++i) x[i] = random_uniform(r, low, high);
}

/* --------------------------------------------------------------------------------------------
 * threads: a caller's own parallel-for
 * -------------------------------------------------------------------------------------------- */

typedef struct test_loop {
    sfem_int
        next; /* indices are handed out from the last to the first: nobody may count on order */
    sfem_task task;
    void *data;
} test_loop;

TEST_STATIC void *test_thread(void *argument)
{
    test_loop *loop = (test_loop *)argument;
    sfem_int i;
    while ((i = __atomic_sub_fetch(&loop->next, 1, __ATOMIC_RELAXED)) >= 0)
        loop->task(loop->data, i);
    return NULL;
}

#define TEST_THREADS 64

/* user: the number of threads, as thread_exec puts it there */
TEST_STATIC void test_parallel_for(sfem_int count, sfem_task task, void *data, void *user)
{
    pthread_t thread[TEST_THREADS];
    test_loop loop;
    intptr_t i, started = 0, wanted = (intptr_t)user;
    loop.next = count;
    loop.task = task;
    loop.data = data;
    while (started < wanted - 1 && started < TEST_THREADS) {
        if (pthread_create(&thread[started], NULL, test_thread, &loop)) break;
        ++started;
    }
    test_thread(&loop); /* this thread works too */
    for (i = 0; i < started; ++i) pthread_join(thread[i], NULL);
}

TEST_STATIC sfem_exec thread_exec(sfem_int threads)
{
    sfem_exec e;
    e.threads = threads;
    e.parallel_for = test_parallel_for;
    e.user = (void *)(intptr_t)threads;
    return e;
}

/* OpenMP, where it is compiled in; else the calling thread alone */
TEST_STATIC sfem_exec openmp_exec(sfem_int threads)
{
    sfem_exec e;
    e.threads = threads;
    e.parallel_for = NULL;
    e.user = NULL;
    return e;
}

/* --------------------------------------------------------------------------------------------
 * files
 * -------------------------------------------------------------------------------------------- */

/* one of four buffers in turn, so that a few paths can be held at once */
TEST_STATIC char *test_path(const char *directory, const char *name)
{
    static char path[4][1024];
    static int turn = 0;
    turn = (turn + 1) % 4;
    snprintf(path[turn], sizeof path[turn], "%s/%s", directory, name);
    return path[turn];
}

/* A mesh file of the directory SFEM_MESHES, or NULL where either is absent; then the test passes:
 * if (!path) skip(). */
TEST_STATIC const char *mesh_path(const char *name)
{
    const char *directory = getenv("SFEM_MESHES");
    const char *path = directory && *directory ? test_path(directory, name) : NULL;
    return path && access(path, R_OK) == 0 ? path : NULL;
}

/* a file that the test may write and should remove */
TEST_STATIC const char *scratch_path(const char *name)
{
    const char *directory = getenv("SFEM_SCRATCH");
    return test_path(directory && *directory ? directory : "/tmp", name);
}

TEST_STATIC void scratch_write(const char *path, const char *text)
{
    FILE *f = fopen(path, "wb");
    assert_non_null(f);
    assert_int_equal(fwrite(text, 1, strlen(text), f), strlen(text));
    assert_int_equal(fclose(f), 0);
}

/* -------------------------------------------------------------------------------------------- */

TEST_STATIC void test_select(void)
{
    const char *pattern = getenv("SFEM_FILTER");
    if (pattern && *pattern) cmocka_set_test_filter(pattern);
}

#define run_all_tests(tests) (test_select(), cmocka_run_group_tests(tests, NULL, NULL))

#endif
