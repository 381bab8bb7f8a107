/* Bodies that share a workspace: the same bits as alone, little memory, clear errors. */
#include "support.h"
#include "linear.h"

enum { KINDS = 7, STEPS = 40 };

typedef struct scene {
    sfem_mesh mesh;
    sfem_model *model[3]; /* linear, corotational, linear with a consistent mass */
    sfem_int pins[64], pin_count, end;
    sfem_damage_def damage;
} scene;

static void build(scene *s)
{
    static const sfem_int cells[3] = {5, 2, 2};
    static const sfem_real size[3] = {0.5, 0.2, 0.2};
    test_random random = {5};
    sfem_error err;
    sfem_int i;
    memset(s, 0, sizeof *s);
    assert_ok(sfem_mesh_block(cells, size, SFEM_CELL_5_TETS, NULL, &s->mesh, &err), err);
    for (i = 0; i < s->mesh.nodes; ++i)
        if (s->mesh.x[3 * i] < 1e-9) s->pins[s->pin_count++] = i;
    for (i = 0; i < 3 * s->mesh.nodes; ++i) s->mesh.x[i] += random_uniform(&random, -0.01, 0.01);
    s->end = s->mesh.nodes - 1;
    for (i = 0; i < 3; ++i) {
        sfem_model_def def = linear_model_def();
        def.mesh = &s->mesh;
        def.material.young = 2e5;
        def.material.law = i == 1 ? SFEM_COROTATIONAL : SFEM_LINEAR;
        def.material.stiffness_damping = 1e-3;
        if (i == 2) def.mass = SFEM_MASS_CONSISTENT;
        assert_ok(sfem_model_create(&def, &s->model[i], &err), err);
    }
    s->damage = sfem_default_damage_def();
    s->damage.toughness = 5;
}

static void drop(scene *s)
{
    int i;
    for (i = 0; i < 3; ++i) sfem_model_free(s->model[i]);
    sfem_mesh_free(&s->mesh);
}

/* Every method, and what each has in the workspace. */
static sfem_body *make(const scene *s, int kind, sfem_workspace *workspace)
{
    sfem_body_def def = exact_body_def();
    sfem_body *body = NULL;
    sfem_error err;
    def.workspace = workspace;
    def.pins = s->pins;
    def.pin_count = s->pin_count;
    def.gravity[2] = -9.81;
    if (kind == 2) def.integrator = SFEM_KR_ALPHA;
    if (kind == 3) def.integrator = SFEM_NEWMARK;
    if (kind == 5) def.damage = &s->damage;
    if (kind == 6) def.pin_count = 0;
    assert_ok(sfem_body_create(s->model[kind == 1 ? 2 : kind < 3 ? 0 : 1], &def, &body, &err), err);
    return body;
}

/* What happens to a body in step k: statics, handles, pins, looks at it. */
static void act(const scene *s, sfem_body *body, int kind, int k, sfem_int *handle)
{
    double x[3], force[3 * 64];
    sfem_error err;
    assert_true(s->mesh.nodes <= 64);
    if (k == 0 && kind != 6) assert_ok(sfem_body_solve_static(body, &err), err);
    if (k == 5) assert_ok(sfem_body_grab_node(body, s->end, handle, &err), err);
    if (k >= 5 && k < 20) {
        sfem_body_handle_position(body, *handle, x);
        x[1] += 0.01;
        assert_ok(sfem_body_move_handle(body, *handle, x, &err), err);
    }
    if (k == 20) sfem_body_release_handle(body, *handle);
    if (k == 30 && kind != 6) assert_ok(sfem_body_set_pins(body, s->pin_count - 2, s->pins, NULL, &err), err);
    if (k % 3 == 0) (void)sfem_body_energy(body);
    if (k % 4 == 0) sfem_body_reactions(body, force);
    assert_ok(sfem_body_step(body, k % 10 == 9 ? 0.02 : 0.01, &err), err);
}

static void same_state(const sfem_body *a, const sfem_body *b, int kind)
{
    const size_t bytes = sfem_body_state_size(a);
    void *x = malloc(bytes), *y = malloc(bytes);
    assert_non_null(x);
    assert_non_null(y);
    assert_int_equal(bytes, sfem_body_state_size(b));
    sfem_body_save_state(a, x);
    sfem_body_save_state(b, y);
    if (memcmp(x, y, bytes)) fail_msg("body of kind %d: other bits with a shared workspace", kind);
    free(x);
    free(y);
}

static void bodies_that_share_a_workspace_move_as_if_alone(void **state)
{
    scene s;
    sfem_workspace *workspace = NULL;
    sfem_body *alone[KINDS], *sharing[KINDS];
    sfem_int handle[2][KINDS];
    sfem_error err;
    int i, k;
    (void)state;
    build(&s);
    assert_ok(sfem_workspace_create(NULL, &workspace, &err), err);
    for (i = 0; i < KINDS; ++i) {
        alone[i] = make(&s, i, NULL);
        sharing[i] = make(&s, i, workspace);
    }
    for (k = 0; k < STEPS; ++k)
        for (i = 0; i < KINDS; ++i) {
            act(&s, alone[i], i, k, handle[0] + i);
            act(&s, sharing[i], i, k, handle[1] + i);
        }
    for (i = 0; i < KINDS; ++i) {
        same_state(alone[i], sharing[i], i);
        sfem_body_free(alone[i]);
        sfem_body_free(sharing[i]);
    }
    sfem_workspace_free(workspace);
    drop(&s);
}

/* Predict, solve and finish of one body with whole looks at it between them; others wait. */
static void a_body_in_its_step_keeps_the_workspace(void **state)
{
    static const sfem_real push[3] = {1, 2, 3};
    scene s;
    sfem_workspace *workspace = NULL;
    sfem_body *alone, *one, *other, *refused = NULL;
    sfem_body_def def = exact_body_def();
    sfem_error err;
    int k;
    (void)state;
    build(&s);
    assert_ok(sfem_workspace_create(NULL, &workspace, &err), err);
    alone = make(&s, 4, NULL);
    one = make(&s, 4, workspace);
    other = make(&s, 5, workspace);
    for (k = 0; k < 20; ++k) {
        sfem_body *both[2];
        int i;
        both[0] = alone;
        both[1] = one;
        for (i = 0; i < 2; ++i) {
            assert_ok(sfem_body_predict(both[i], 0.01, &err), err);
            if (i == 1) {
                assert_int_equal(sfem_body_step(other, 0.01, &err), SFEM_BAD_ARGUMENT);
                assert_non_null(strstr(err.text, "shares the workspace"));
                assert_int_equal(sfem_body_prepare(other, 0.015, &err), SFEM_BAD_ARGUMENT);
                assert_int_equal(sfem_body_solve_static(other, &err), SFEM_BAD_ARGUMENT);
                assert_int_equal(sfem_body_set_pins(other, 1, s.pins, NULL, &err), SFEM_BAD_ARGUMENT);
                def.workspace = workspace;
                assert_int_equal(sfem_body_create(s.model[1], &def, &refused, &err), SFEM_BAD_ARGUMENT);
                assert_null(refused);
            }
            sfem_body_rhs(both[i])[3 * s.end] += 2;
            (void)sfem_body_energy(both[i]);
            assert_ok(sfem_body_solve(both[i], &err), err);
            assert_ok(sfem_body_add_impulse(both[i], s.end, push, &err), err);
            assert_ok(sfem_body_finish(both[i], &err), err);
        }
        assert_ok(sfem_body_step(other, 0.01, &err), err);
        (void)sfem_body_energy(other);
    }
    same_state(alone, one, 4);
    /* a body that goes away in the middle of a step gives the workspace back */
    assert_ok(sfem_body_predict(one, 0.01, &err), err);
    sfem_body_free(one);
    assert_ok(sfem_body_step(other, 0.01, &err), err);
    sfem_body_free(other);
    sfem_body_free(alone);
    sfem_workspace_free(workspace);
    drop(&s);
}

/* ---- memory ---- */

typedef struct counter {
    size_t bytes;
} counter;

static void *count_alloc(size_t bytes, void *user)
{
    size_t *p = (size_t *)malloc(bytes + 64);
    if (!p) return NULL;
    *p = bytes;
    ((counter *)user)->bytes += bytes;
    return (char *)p + 64;
}

static void count_free(void *p, void *user)
{
    size_t *q;
    if (!p) return;
    q = (size_t *)(void *)((char *)p - 64);
    ((counter *)user)->bytes -= *q;
    free(q);
}

static void a_rotating_body_that_shares_takes_150_bytes_a_node_beyond_its_state(void **state)
{
    static const sfem_int cells[3] = {20, 6, 7};
    static const sfem_real size[3] = {2, 0.6, 0.7};
    counter count = {0};
    sfem_model_def model_def = linear_model_def();
    sfem_body_def def = exact_body_def();
    sfem_workspace *workspace = NULL;
    sfem_body *body[10];
    sfem_model *model;
    sfem_mesh mesh;
    sfem_error err;
    double beyond;
    sfem_int pin[2] = {0, 1};
    int i, k;
    (void)state;
    assert_ok(sfem_mesh_block(cells, size, SFEM_CELL_5_TETS, NULL, &mesh, &err), err);
    model_def.mesh = &mesh;
    model_def.material.law = SFEM_COROTATIONAL;
    assert_ok(sfem_model_create(&model_def, &model, &err), err);
    assert_ok(sfem_workspace_create(NULL, &workspace, &err), err);
    def.workspace = workspace;
    def.pins = pin;
    def.pin_count = 2;
    def.gravity[1] = -9.81;
    def.allocator.allocate = count_alloc;
    def.allocator.release = count_free;
    def.allocator.user = &count;
    for (i = 0; i < 10; ++i) assert_ok(sfem_body_create(model, &def, body + i, &err), err);
    for (k = 0; k < 3; ++k)
        for (i = 0; i < 10; ++i) assert_ok(sfem_body_step(body[i], 0.01, &err), err);
    beyond = ((double)count.bytes / 10 - (double)sfem_body_state_size(body[0])) / mesh.nodes;
    print_message("%d nodes: %.0f bytes a node beyond a state of %.0f; the workspace %.0f\n", (int)mesh.nodes, beyond,
                  (double)sfem_body_state_size(body[0]) / mesh.nodes,
                  (double)sfem_workspace_bytes(workspace) / mesh.nodes);
    assert_true(beyond <= 150);
    /* what a body says of itself is what it took */
    assert_true(fabs((double)sfem_body_get_info(body[0]).body_bytes - (double)count.bytes / 10) <
                0.02 * (double)count.bytes / 10);
    for (i = 0; i < 10; ++i) sfem_body_free(body[i]);
    assert_int_equal(count.bytes, 0);
    sfem_workspace_free(workspace);
    sfem_model_free(model);
    sfem_mesh_free(&mesh);
}

static sfem_status attempt(sfem_allocator allocator, void *user, sfem_error *err)
{
    const scene *s = (const scene *)user;
    sfem_workspace *workspace = NULL;
    sfem_body *body = NULL;
    sfem_body_def def = exact_body_def();
    sfem_status status = sfem_workspace_create(&allocator, &workspace, err);
    def.workspace = workspace;
    def.pins = s->pins;
    def.pin_count = s->pin_count;
    def.allocator = allocator;
    if (status == SFEM_OK) status = sfem_body_create(s->model[1], &def, &body, err);
    if (status == SFEM_OK) status = sfem_body_step(body, 0.01, err);
    sfem_body_free(body);
    sfem_workspace_free(workspace);
    return status;
}

static void every_allocation_may_fail(void **state)
{
    scene s;
    (void)state;
    build(&s);
    assert_true(fail_every_allocation(attempt, &s) > 5);
    drop(&s);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(bodies_that_share_a_workspace_move_as_if_alone),
        cmocka_unit_test(a_body_in_its_step_keeps_the_workspace),
        cmocka_unit_test(a_rotating_body_that_shares_takes_150_bytes_a_node_beyond_its_state),
        cmocka_unit_test(every_allocation_may_fail),
    };
    return run_all_tests(tests);
}
