/* The base section: status, errors, memory, threads, small vectors. Compiled with -ffast-math,
 * under which a compiler may take every number for finite. */
#define SFEM_STATIC
#define SFEM_MINIMAL
#define SOFTFEM_IMPLEMENTATION
#include "support.h"

static void every_status_has_a_text_of_its_own(void **state)
{
    int i, j;
    (void)state;
    for (i = 0; i < (int)SFEM_STATUS_COUNT; ++i) {
        const char *text = sfem_status_text((sfem_status)i);
        assert_non_null(text);
        assert_true(strlen(text) > 1);
        assert_string_not_equal(text, "unknown status");
        for (j = 0; j < i; ++j) assert_string_not_equal(text, sfem_status_text((sfem_status)j));
    }
}

static void a_status_that_does_not_exist_is_unknown(void **state)
{
    (void)state;
    assert_string_equal(sfem_status_text(SFEM_STATUS_COUNT), "unknown status");
    assert_string_equal(sfem_status_text((sfem_status)-1), "unknown status");
}

static void the_version_is_one_number(void **state)
{
    (void)state;
    assert_int_equal(SFEM_VERSION,
                     SFEM_VERSION_MAJOR * 10000 + SFEM_VERSION_MINOR * 100 + SFEM_VERSION_PATCH);
}

static void an_error_names_its_place(void **state)
{
    sfem_error err;
    (void)state;
    assert_int_equal(sfemi_fail_at(&err, SFEM_BAD_MESH, 17, 4, "node %d is held by nothing", 17),
                     SFEM_BAD_MESH);
    assert_int_equal(err.status, SFEM_BAD_MESH);
    assert_int_equal(err.node, 17);
    assert_int_equal(err.tet, 4);
    assert_int_equal(err.line, -1);
    assert_string_equal(err.text, "node 17 is held by nothing");
    assert_int_equal(sfemi_fail(&err, SFEM_SINGULAR, "%s", "no"), SFEM_SINGULAR);
    assert_int_equal(err.node, -1);
    assert_int_equal(err.tet, -1);
}

static void an_error_may_be_left_out(void **state)
{
    (void)state;
    assert_int_equal(sfemi_fail(NULL, SFEM_IO, "%s", "nobody reads this"), SFEM_IO);
}

static void a_long_error_text_is_cut(void **state)
{
    struct {
        sfem_error err;
        char guard[8];
    } e;
    char text[1000];
    (void)state;
    memset(text, 'x', sizeof text - 1);
    text[sizeof text - 1] = 0;
    memset(e.guard, 7, sizeof e.guard);
    sfemi_fail(&e.err, SFEM_FORMAT, "%s", text);
    assert_int_equal(strlen(e.err.text), sizeof e.err.text - 1);
    assert_int_equal(e.guard[0], 7);
}

static double from_bits(uint64_t bits)
{
    double x;
    memcpy(&x, &bits, sizeof x);
    return x;
}

static void finite_is_seen_under_fast_math(void **state)
{
    /* +-0, smallest and largest subnormal, +-largest, 1, -3.14 */
    static const uint64_t finite[] = {0x0000000000000000u, 0x8000000000000000u, 0x0000000000000001u,
                                      0x000fffffffffffffu, 0x7fefffffffffffffu, 0xffefffffffffffffu,
                                      0x3ff0000000000000u, 0xc0091eb851eb851fu};
    /* +-infinity, quiet and signalling NaN */
    static const uint64_t not_finite[] = {0x7ff0000000000000u, 0xfff0000000000000u,
                                          0x7ff8000000000000u, 0xfff8000000000001u,
                                          0x7ff0000000000001u, 0xffffffffffffffffu};
    sfem_real x[9];
    size_t i, k;
    (void)state;
#ifndef __FAST_MATH__
    fail_msg("compile this test with -ffast-math");
#endif
    for (i = 0; i < TEST_COUNT(finite); ++i) assert_true(sfemi_finite(from_bits(finite[i])));
    for (i = 0; i < TEST_COUNT(not_finite); ++i)
        assert_false(sfemi_finite(from_bits(not_finite[i])));
    for (i = 0; i < TEST_COUNT(not_finite); ++i) {
        for (k = 0; k < TEST_COUNT(x); ++k) {
            memset(x, 0, sizeof x);
            memcpy(&x[k], &not_finite[i], sizeof x[k]); /* one bad number, at every place */
            assert_false(sfemi_all_finite(x, TEST_COUNT(x)));
            assert_true(sfemi_all_finite(x, k));
        }
    }
}

static void memory_is_zeroed_and_aligned(void **state)
{
    size_t bytes;
    (void)state;
    for (bytes = 0; bytes < 300; ++bytes) {
        test_memory memory = {0};
        sfem_allocator a = test_allocator(&memory);
        char *block = (char *)sfemi_new(&a, bytes, 1);
        size_t i;
        assert_non_null(block);
        assert_int_equal((uintptr_t)block % SFEMI_ALIGN, 0);
        for (i = 0; i < bytes; ++i) assert_int_equal(block[i], 0);
        memset(block, 1, bytes); /* the address sanitizer watches the end */
        sfemi_delete(&a, block);
        assert_int_equal(memory.calls, 1);
        assert_no_leak(memory);
    }
}

static void malloc_serves_where_no_allocator_is_given(void **state)
{
    sfem_allocator a;
    double *x;
    (void)state;
    memset(&a, 0, sizeof a);
    x = (double *)sfemi_new(&a, 1000, sizeof *x);
    assert_non_null(x);
    assert_int_equal((uintptr_t)x % SFEMI_ALIGN, 0);
    x[999] = 1;
    sfemi_delete(&a, x);
    sfemi_delete(&a, NULL);
}

static void a_size_that_overflows_is_refused(void **state)
{
    const size_t most = (size_t)-1;
    const size_t sizes[][2] = {{most, 1}, {most / 2 + 1, 2}, {most / 8 + 1, 8},
                               {2, most}, {most, most},      {most - SFEMI_ALIGN, 1}};
    test_memory memory = {0};
    sfem_allocator a = test_allocator(&memory);
    size_t i;
    (void)state;
    for (i = 0; i < TEST_COUNT(sizes); ++i) assert_null(sfemi_new(&a, sizes[i][0], sizes[i][1]));
    assert_int_equal(memory.calls, 0); /* refused before the allocator is asked for too little */
}

static sfem_status three_blocks(sfem_allocator allocator, void *user, sfem_error *err)
{
    sfem_status status = SFEM_OK;
    double *a = NULL, *b = NULL, *c = NULL;
    (void)user;
    SFEMI_NEW(double, a, &allocator, 10);
    SFEMI_NEW(double, b, &allocator, 20);
    SFEMI_NEW(double, c, &allocator, 30);
done:
    sfemi_delete(&allocator, c);
    sfemi_delete(&allocator, b);
    sfemi_delete(&allocator, a);
    return status;
}

static void a_failed_allocation_leaves_nothing_behind(void **state)
{
    (void)state;
    assert_int_equal(fail_every_allocation(three_blocks, NULL), 3);
}

enum { LOOP = 1000 };

static void visit(void *data, sfem_int i)
{
    ++((sfem_int *)data)[i]; /* each index is one task's: no two threads share an element */
}

static void runs_once_for_each_index(const sfem_exec *exec, sfem_int count)
{
    sfem_int visits[LOOP] = {0};
    sfem_int i;
    sfemi_run(exec, count, visit, visits);
    for (i = 0; i < LOOP; ++i) assert_int_equal(visits[i], i < count ? 1 : 0);
}

static void loops_visit_each_index_once_on_any_number_of_threads(void **state)
{
    static const sfem_int counts[] = {0, 1, 2, 3, 64, LOOP};
    sfem_exec serial;
    sfem_int threads;
    size_t k;
    (void)state;
    memset(&serial, 0, sizeof serial);
    for (k = 0; k < TEST_COUNT(counts); ++k) {
        runs_once_for_each_index(NULL, counts[k]);
        runs_once_for_each_index(&serial, counts[k]);
        for (threads = 1; threads <= 8; threads *= 2) {
            const sfem_exec own = thread_exec(threads), openmp = openmp_exec(threads);
            runs_once_for_each_index(&own, counts[k]);
            runs_once_for_each_index(&openmp, counts[k]);
        }
    }
}

static void without_threads_a_caller_gets_one(void **state)
{
    sfem_exec exec = thread_exec(4);
    (void)state;
    assert_int_equal(sfemi_threads(&exec), 4);
    exec.threads = 0;
    assert_int_equal(sfemi_threads(&exec), 1);
    exec.threads = -3;
    assert_int_equal(sfemi_threads(&exec), 1);
    assert_int_equal(sfemi_threads(NULL), 1);
    exec = openmp_exec(4);
#ifdef _OPENMP
    assert_int_equal(sfemi_threads(&exec), 4);
#else
    assert_int_equal(sfemi_threads(&exec), 1);
#endif
}

static void volume_of_a_tet_has_its_sign(void **state)
{
    const sfem_real a[3] = {1, 1, 1}, b[3] = {3, 1, 1}, c[3] = {1, 4, 1}, d[3] = {1, 1, 6};
    (void)state;
    assert_near(sfemi_volume6(a, b, c, d), 30, 0, 0);
    assert_near(sfemi_volume6(a, c, b, d), -30, 0, 0);
    assert_near(sfemi_volume6(a, b, c, c), 0, 0, 0);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(every_status_has_a_text_of_its_own),
        cmocka_unit_test(a_status_that_does_not_exist_is_unknown),
        cmocka_unit_test(the_version_is_one_number),
        cmocka_unit_test(an_error_names_its_place),
        cmocka_unit_test(an_error_may_be_left_out),
        cmocka_unit_test(a_long_error_text_is_cut),
        cmocka_unit_test(finite_is_seen_under_fast_math),
        cmocka_unit_test(memory_is_zeroed_and_aligned),
        cmocka_unit_test(malloc_serves_where_no_allocator_is_given),
        cmocka_unit_test(a_size_that_overflows_is_refused),
        cmocka_unit_test(a_failed_allocation_leaves_nothing_behind),
        cmocka_unit_test(loops_visit_each_index_once_on_any_number_of_threads),
        cmocka_unit_test(without_threads_a_caller_gets_one),
        cmocka_unit_test(volume_of_a_tet_has_its_sign),
    };
    return run_all_tests(tests);
}
