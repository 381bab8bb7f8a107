/* How much stack a step takes: a thread of its own steps on a painted one. */
#include "scene.h"

enum { STACK = 1 << 20, PAINT = 0x5c };

typedef struct stepper {
    sfem_body *body;
    double h;
    unsigned char *stack;
    size_t used;
} stepper;

static void *prepare_and_step(void *argument)
{
    stepper *s = (stepper *)argument;
    const unsigned char *here = (const unsigned char *)__builtin_frame_address(0);
    const unsigned char *untouched = s->stack;
    sfem_error err;
    int i;
    for (i = 0; i < 6; ++i) (void)sfem_body_step(s->body, s->h, &err); /* the first makes the factor */
    while (untouched < here && *untouched == PAINT) ++untouched;
    s->used = (size_t)(here - untouched);
    return NULL;
}

/* Bytes of stack that six steps reach below their caller. */
static size_t stack_of_steps(sfem_body *body, double h)
{
    pthread_attr_t attributes;
    pthread_t thread;
    stepper s;
    s.body = body;
    s.h = h;
    s.used = 0;
    s.stack = NULL;
    assert_int_equal(posix_memalign((void **)&s.stack, 4096, STACK), 0);
    memset(s.stack, PAINT, STACK);
    assert_int_equal(pthread_attr_init(&attributes), 0);
    assert_int_equal(pthread_attr_setstack(&attributes, s.stack, STACK), 0);
    assert_int_equal(pthread_create(&thread, &attributes, prepare_and_step, &s), 0);
    pthread_join(thread, NULL);
    pthread_attr_destroy(&attributes);
    free(s.stack);
    return s.used;
}

/* At rest first, then displaced by random 0.3 m at cells of 0.1 m, which is rejected: fallbacks run, too. */
static size_t stack_of_scene(sfem_law law, sfem_body_def def)
{
    sfem_material material = rubber(1e5);
    sfem_real u[3 * MAX_NODES];
    test_random random = {3};
    size_t calm, wild;
    sfem_int handle;
    sfem_error err;
    scene s;
    material.law = law;
    s = bar(10, 3, material);
    def.gravity[1] = -9.81;
    add_body(&s, def, 1);
    assert_ok(sfem_body_grab_node(s.body, s.n - 1, &handle, &err), err);
    calm = stack_of_steps(s.body, 0.01);
    random_fill(&random, u, 3 * (size_t)s.n, -0.3, 0.3);
    assert_ok(sfem_body_set_state(s.body, u, u, &err), err);
    wild = stack_of_steps(s.body, 0.01);
    drop(&s);
    return calm > wild ? calm : wild;
}

static void a_step_takes_at_most_16_kB_of_stack(void **state)
{
    static const sfem_integrator by[4] = {SFEM_PQR, SFEM_KR_ALPHA, SFEM_BATHE, SFEM_GENERALIZED_ALPHA};
    static const sfem_law law[4] = {SFEM_LINEAR, SFEM_COROTATIONAL, SFEM_STVK, SFEM_NEOHOOKEAN};
    const size_t most = 16384;
    sfem_damage_def damage = sfem_default_damage_def();
    sfem_body_def def;
    size_t used;
    int i, k;
    (void)state;
#if !defined(__OPTIMIZE__) || defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
    skip(); /* every local variable has a place of its own there */
#endif
    for (i = 0; i < 4; ++i)
        for (k = 0; k < 4; ++k) {
            def = exact_body_def();
            def.integrator = by[i];
            used = stack_of_scene(law[k], def);
            if (used > most) fail_msg("integrator %d, law %d: %lu bytes", (int)by[i], (int)law[k], (unsigned long)used);
            assert_true(used > 1000); /* so much the solver alone takes: it was measured */
        }
    def = exact_body_def();
    damage.toughness = 1;
    def.damage = &damage;
    def.refactorise = 1;
    used = stack_of_scene(SFEM_COROTATIONAL, def);
    if (used > most) fail_msg("damage and a factor of what is left: %lu bytes", (unsigned long)used);
    def = exact_body_def();
    def.precision = SFEM_MIXED;
    used = stack_of_scene(SFEM_NEOHOOKEAN, def);
    if (used > most) fail_msg("mixed precision: %lu bytes", (unsigned long)used);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_step_takes_at_most_16_kB_of_stack),
    };
    return run_all_tests(tests);
}
