/* Factors of the present tangent: made in slices of counted operations, swapped whole, and what they are good for. */
#define SFEM_STATIC
#define SFEM_MINIMAL
#define SFEM_ENABLE_DAMAGE
#define SFEM_ENABLE_NEWTON
#define SFEM_ENABLE_MESHIO
#define SOFTFEM_IMPLEMENTATION
#include "support.h"
#include "bodies.h"
#include "linear.h"

#define H (1.0 / 60)

/* --------------------------------------------------------------------------------------------
 * scenes: bars along x, clamped at x = 0
 * -------------------------------------------------------------------------------------------- */

typedef struct scene {
    sfem_mesh mesh;
    sfem_model *model;
    sfem_body *body;
    sfem_int pins[128], pin_count;
} scene;

static scene bar(sfem_int nx, sfem_int ny, sfem_law law, double young, int both_ends)
{
    const sfem_int cells[3] = {nx, ny, ny};
    const sfem_real size[3] = {2, 2.0 * ny / nx, 2.0 * ny / nx};
    sfem_model_def def = linear_model_def();
    sfem_error err;
    sfem_int i;
    scene s;
    memset(&s, 0, sizeof s);
    assert_ok(sfem_mesh_block(cells, size, SFEM_CELL_5_TETS, NULL, &s.mesh, &err), err);
    for (i = 0; i < s.mesh.nodes; ++i)
        if (s.mesh.x[3 * i] < 1e-9 || (both_ends && s.mesh.x[3 * i] > 2 - 1e-9))
            s.pins[s.pin_count++] = i;
    def.mesh = &s.mesh;
    def.material.law = law;
    def.material.young = young;
    assert_ok(sfem_model_create(&def, &s.model, &err), err);
    return s;
}

static sfem_body_def soft(double work)
{
    sfem_body_def def = exact_body_def();
    def.gravity[2] = -9.81;
    def.refactorise = work;
    def.p = 0.27; /* the same with and without */
    return def;
}

static void add_body(scene *s, sfem_body_def def, int held)
{
    sfem_error err;
    if (held) {
        def.pins = s->pins;
        def.pin_count = s->pin_count;
    }
    assert_ok(sfem_body_create(s->model, &def, &s->body, &err), err);
    assert_ok(sfem_body_prepare(s->body, H, &err), err);
}

static void drop_body(scene *s)
{
    sfem_body_free(s->body);
    s->body = NULL;
}

static void drop(scene *s)
{
    drop_body(s);
    sfem_model_free(s->model);
    sfem_mesh_free(&s->mesh);
}

static void run(sfem_body *body, int steps)
{
    sfem_error err;
    while (steps-- > 0) assert_ok(sfem_body_step(body, H, &err), err);
}

static void refactorise(sfem_body *body)
{
    sfem_error err;
    assert_ok(sfem_body_refactorise(body, NULL, &err), err);
}

static uint64_t bits(const sfem_body *body)
{
    const size_t n = 3 * (size_t)body->model->mesh.nodes;
    return hash_reals(body->state.u, n) ^ (hash_reals(body->state.w, n) << 1);
}

/* --------------------------------------------------------------------------------------------
 * the factorisation in slices
 * -------------------------------------------------------------------------------------------- */

static void slices_have_the_bits_of_one_stroke(void **state)
{
    int mixed;
    (void)state;
    for (mixed = 0; mixed < 2; ++mixed) {
        scene s = bar(12, 6, SFEM_COROTATIONAL, 1e6, 0); /* with fronts that are cut */
        sfem_body_def def = soft(0);
        const sfem_ldl *whole;
        sfemi_slice at;
        sfem_matrix a;
        sfem_ldl *ldl = NULL;
        sfem_error err;
        double cost, sum = 0, most = 0, largest = 0;
        sfem_int k;
        def.precision = mixed ? SFEM_MIXED : SFEM_DOUBLE;
        add_body(&s, def, 1);
        whole = s.body->factor->ldl;
        assert_ok(sfemi_factor_matrix(s.model, s.body->factor, &a, &err), err);
        (void)SFEMI_ATOMIC_ADD(&whole->symbolic->references, 1);
        assert_ok(sfemi_ldl_make(whole, whole->symbolic, NULL, NULL, &ldl, &err), err);
        assert_false(ldl->valid);
        sfemi_slice_start(ldl, &a, &at);
        while ((cost = sfemi_slice_next(ldl, &a, &at)) > 0) {
            sum += cost;
            most = fmax(most, cost);
        }
        assert_true(cost == 0 && ldl->valid);
        assert_near(sum, sfemi_slice_total(ldl), 1e-12, 0);
        for (k = 0; k < whole->symbolic->supernodes; ++k)
            largest = fmax(largest, sfemi_front_flops(whole->symbolic, k));
        assert_true(largest > SFEMI_SLICE_FRONT && most < largest / 2);
        assert_memory_equal(ldl->l, whole->l,
                            whole->symbolic->panel[whole->symbolic->supernodes] * sizeof *ldl->l);
        if (mixed)
            assert_memory_equal(ldl->l32, whole->l32,
                                whole->symbolic->panel32[whole->symbolic->supernodes] *
                                    sizeof *ldl->l32);
        assert_true(ldl->pivot_min == whole->pivot_min && ldl->pivot_max == whole->pivot_max);
        sfem_ldl_free(ldl);
        sfem_matrix_free(&a);
        drop(&s);
    }
}

/* The body goes on with the old factor, to the bit, until the counted number of steps is over; then
 * with a factor that has the bits of one made at a stroke. */
static void a_factor_is_swapped_whole_after_the_counted_steps(void **state)
{
    int slice;
    (void)state;
    for (slice = 0; slice < 3; ++slice) {
        static const double share[3] = {2.0, 0.3, 0.04};
        scene s = bar(8, 2, SFEM_COROTATIONAL, 1e5, 0), old;
        sfem_refactorisation info = {0};
        sfem_ldl *whole = NULL;
        sfem_error err;
        double flops;
        int k, wanted;
        old = s;
        add_body(&s, soft(1), 1);
        add_body(&old, soft(1), 1); /* of the same p, and never asked */
        run(s.body, 10);
        run(old.body, 10);
        refactorise(s.body);
        flops = sfem_body_get_refactorisation(s.body).flops;
        s.body->refactor.budget = share[slice] * flops;
        wanted = (int)ceil(1 / share[slice]);
        for (k = 1; k <= wanted; ++k) {
            assert_false(sfem_body_get_refactorisation(s.body).in_use);
            run(s.body, 1);
            run(old.body, 1);
            assert_true(bits(s.body) == bits(old.body));
            info = sfem_body_get_refactorisation(s.body);
            assert_true(info.done <= k * share[slice] * flops + 2e6 && info.flops == flops);
            if (info.in_use) break;
            assert_true(info.running && info.done >= k * share[slice] * flops);
        }
        /* the last slice overdraws, so that it may end a step early */
        assert_true(info.in_use && !info.running && info.made == 1 && k >= wanted - 1);
        assert_near(info.done, flops, 1e-12, 0);
        assert_ok(sfem_ldl_create_like(old.body->factor->ldl, &s.body->refactor.a, NULL, &whole, &err),
                  err);
        assert_memory_equal(s.body->refactor.ldl[0]->l, whole->l,
                            whole->symbolic->panel[whole->symbolic->supernodes] * sizeof *whole->l);
        sfem_ldl_free(whole);
        run(s.body, 1);
        run(old.body, 1);
        assert_true(bits(s.body) != bits(old.body));
        drop_body(&old);
        drop(&s);
    }
}

/* --------------------------------------------------------------------------------------------
 * what is factorised
 * -------------------------------------------------------------------------------------------- */

/* The tangent of a body that is rotated as a whole, rotated back, is K. */
static void a_body_that_was_only_rotated_gets_its_old_factor(void **state)
{
    scene s = bar(6, 2, SFEM_COROTATIONAL, 1e6, 0);
    const double q[9] = {0.36, 0.48, -0.8, -0.8, 0.6, 0, 0.48, 0.64, 0.6};
    const size_t blocks = (size_t)s.model->row[s.mesh.nodes];
    double *u = (double *)calloc(3 * (size_t)s.mesh.nodes, sizeof *u);
    sfem_body_def def = soft(1e12);
    sfem_error err;
    sfem_int i;
    int r, c;
    (void)state;
    for (i = 0; i < s.mesh.nodes; ++i)
        for (r = 0; r < 3; ++r)
            for (c = 0; c < 3; ++c) u[3 * i + r] += (q[3 * r + c] - (r == c)) * s.mesh.x[3 * i + c];
    def.gravity[2] = 0;
    add_body(&s, def, 0);
    assert_ok(sfem_body_set_state(s.body, u, NULL, &err), err);
    refactorise(s.body);
    run(s.body, 1);
    assert_true(sfem_body_get_refactorisation(s.body).in_use);
    assert_all_near(s.body->refactor.k[0].val, s.model->stiffness.val, 9 * blocks, 1e-11, 0);
    run(s.body, 20); /* and stays where it is */
    assert_all_near(s.body->state.u, u, 3 * s.mesh.nodes, 1e-9, 0);
    free(u);
    drop(&s);
}

/* A matrix that is handed in serves as the body's own tangent does. */
static void a_matrix_of_the_callers_is_taken(void **state)
{
    scene s = bar(6, 2, SFEM_NEOHOOKEAN, 1e5, 0), other;
    sfem_error err;
    sfem_matrix k;
    (void)state;
    other = s;
    add_body(&s, soft(1e12), 1);
    add_body(&other, soft(1e12), 1);
    run(s.body, 25);
    run(other.body, 25);
    refactorise(s.body);
    assert_ok(sfem_model_combine(s.model, 1, 0, 0, NULL, &k, &err), err);
    sfem_model_tangent(s.model, other.body->state.u, SFEM_TANGENT_PSD, &k, NULL);
    assert_ok(sfem_body_refactorise(other.body, &k, &err), err);
    sfem_matrix_free(&k); /* it was copied */
    run(s.body, 30);
    run(other.body, 30);
    assert_int_equal(sfem_body_get_refactorisation(other.body).made, 1);
    assert_all_near(s.body->state.u, other.body->state.u, 3 * s.mesh.nodes, 1e-9, 0);
    drop_body(&other);
    drop(&s);
}

/* --------------------------------------------------------------------------------------------
 * what it is good for
 * -------------------------------------------------------------------------------------------- */

/* A string of soft material, stretched by half and plucked: mid[3 k] its middle after k steps. */
static sfem_body_info pluck(scene *s, sfem_body_def def, int sub, int again, double *mid,
                            int steps)
{
    const size_t n = (size_t)s->mesh.nodes;
    double *u = (double *)calloc(6 * n, sizeof *u), *v = u + 3 * n;
    sfem_body_info info;
    sfem_error err;
    sfem_int i, middle = 0;
    int k, j;
    def.pins = s->pins;
    def.pin_count = s->pin_count;
    def.refactorise = again ? 1e12 : 0;
    assert_ok(sfem_body_create(s->model, &def, &s->body, &err), err);
    for (i = 0; i < s->mesh.nodes; ++i) {
        const double x = s->mesh.x[3 * i];
        u[3 * i] = 0.5 * x;
        if (fabs(x - 1) < fabs(s->mesh.x[3 * middle] - 1)) middle = i;
    }
    for (i = 0; i < s->pin_count; ++i) {
        const double *x = s->mesh.x + 3 * s->pins[i], place[3] = {1.5 * x[0], x[1], x[2]};
        assert_ok(sfem_body_move_pin(s->body, s->pins[i], place, &err), err);
    }
    assert_ok(sfem_body_set_state(s->body, u, NULL, &err), err);
    assert_ok(sfem_body_solve_static(s->body, &err), err);
    memcpy(u, s->body->state.u, 3 * n * sizeof *u);
    for (i = 0; i < s->mesh.nodes; ++i) v[3 * i + 2] = 1.5 * sin(TEST_PI * s->mesh.x[3 * i] / 2);
    assert_ok(sfem_body_set_state(s->body, u, v, &err), err);
    assert_ok(sfem_body_prepare(s->body, H / sub, &err), err);
    if (again) refactorise(s->body);
    for (k = 0; k < steps; ++k) {
        for (j = 0; j < sub; ++j) assert_ok(sfem_body_step(s->body, H / sub, &err), err);
        memcpy(mid + 3 * k, s->body->state.u + 3 * middle, 3 * sizeof *mid);
    }
    info = sfem_body_get_info(s->body);
    drop_body(s);
    free(u);
    return info;
}

enum { PLUCKED = 90 };

static double distance(const double *a, const double *b)
{
    double sum = 0, most = 0;
    int k;
    for (k = 0; k < 3 * PLUCKED; ++k) {
        sum += (a[k] - b[k]) * (a[k] - b[k]);
        if (k % 3 == 2 && fabs(b[k]) > most) most = fabs(b[k]);
    }
    return sqrt(sum / PLUCKED) / most;
}

/* StVK is three times as stiff there. By one solve with the rest pose's factor and a p for soft tangents, steps are
 * rejected and the motion dies; a factor of the tangent there follows full Newton. Corrected steps do that with either,
 * and that factor saves solves. */
static void a_stretched_string_swings_as_by_newton(void **state)
{
    scene s = bar(8, 2, SFEM_STVK, 1e5, 1);
    double truth[3 * PLUCKED], by[5][3 * PLUCKED], error[5];
    sfem_body_def def = exact_body_def(), newton;
    sfem_body_info info[5];
    int k;
    (void)state;
    newton = def;
    newton.integrator = SFEM_NEWMARK;
    (void)pluck(&s, newton, 8, 0, truth, PLUCKED);
    info[0] = pluck(&s, newton, 1, 0, by[0], PLUCKED);
    info[3] = pluck(&s, def, 1, 0, by[3], PLUCKED);
    info[4] = pluck(&s, def, 1, 1, by[4], PLUCKED);
    def.accuracy = 1;
    def.p = 0.27;
    info[1] = pluck(&s, def, 1, 0, by[1], PLUCKED);
    info[2] = pluck(&s, def, 1, 1, by[2], PLUCKED);
    for (k = 0; k < 5; ++k) {
        error[k] = distance(by[k], truth);
        print_message("    error %.4f, %d of %d rejected, %d solves\n", error[k],
                      (int)info[k].rejected, PLUCKED, (int)info[k].solves);
    }
    assert_true(info[1].rejected > PLUCKED / 6 && info[2].rejected == 0);
    assert_true(error[2] < 1.5 * error[0] && error[1] > 4 * error[2]);
    assert_true(info[3].rejected == 0 && info[4].rejected == 0);
    assert_true(error[3] < 2 * error[0] && error[4] < 2 * error[0]);
    assert_true(info[4].solves < info[3].solves);
    drop(&s);
}

/* A second of an unstructured body with slivers that falls. */
static sfem_body_info fall(const scene *s, double work, double *u, sfem_refactorisation *out)
{
    sfem_body_def def = soft(work);
    sfem_body_info info;
    sfem_body *body;
    sfem_error err;
    def.pins = s->pins;
    def.pin_count = s->pin_count;
    assert_ok(sfem_body_create(s->model, &def, &body, &err), err);
    assert_ok(sfem_body_prepare(body, H, &err), err);
    run(body, 60);
    memcpy(u, sfem_body_displacement(body), 3 * (size_t)s->mesh.nodes * sizeof *u);
    info = sfem_body_get_info(body);
    *out = sfem_body_get_refactorisation(body);
    sfem_body_free(body);
    return info;
}

/* Where tets rotate otherwise than their nodes, corrections soon cost as much as a factor that saves them. */
static void costly_corrections_call_for_a_factor(void **state)
{
    scene s;
    sfem_model_def model = linear_model_def();
    sfem_refactorisation by[2];
    sfem_body_info info[2];
    sfem_error err;
    double *u, far = 0, most = 0;
    sfem_int i;
    int k;
    (void)state;
    memset(&s, 0, sizeof s);
    assert_ok(body_scattered(2000, 0.01, 1, &s.mesh, &err), err);
    model.mesh = &s.mesh;
    model.material.law = SFEM_COROTATIONAL;
    model.material.young = 2e5;
    model.material.poisson = 0.38;
    assert_ok(sfem_model_create(&model, &s.model, &err), err);
    for (i = 0; i < s.mesh.nodes; ++i) most = fmin(most, s.mesh.x[3 * i]);
    for (i = 0; i < s.mesh.nodes; ++i)
        if (s.mesh.x[3 * i] < 0.9 * most && s.pin_count < 128) s.pins[s.pin_count++] = i;
    assert_true(s.pin_count > 2 && s.pin_count < s.mesh.nodes / 4);
    u = (double *)calloc(6 * (size_t)s.mesh.nodes, sizeof *u);
    for (k = 0; k < 2; ++k) info[k] = fall(&s, k ? 4 : 0, u + 3 * (size_t)k * (size_t)s.mesh.nodes, &by[k]);
    for (most = 0, i = 0; i < 3 * s.mesh.nodes; ++i) {
        far = fmax(far, fabs(u[i] - u[i + 3 * s.mesh.nodes]));
        most = fmax(most, fabs(u[i]));
    }
    print_message("    %d solves, %d with %d factors; %.1e of %.1e m apart\n", (int)info[0].solves, (int)info[1].solves,
                  (int)by[1].made, far, most);
    assert_true(by[0].made == 0 && by[1].made > 0 && info[0].rejected + info[1].rejected == 0);
    assert_true((double)info[1].solves < 0.85 * (double)info[0].solves && far < 0.01 * most);
    free(u);
    drop(&s);
}

/* Calm bodies on good meshes do not refactorise. */
static void a_calm_bar_keeps_its_factor(void **state)
{
    scene s = bar(8, 2, SFEM_COROTATIONAL, 1e6, 0);
    (void)state;
    add_body(&s, soft(4), 1);
    run(s.body, 120);
    assert_int_equal(sfem_body_get_refactorisation(s.body).made, 0);
    assert_true(sfem_body_get_refactorisation(s.body).spent < 1);
    drop(&s);
}

/* A violent start, with a factor under way all the time: the energy stays where it was. */
static void violence_makes_no_energy_through_new_factors(void **state)
{
    static const sfem_law law[3] = {SFEM_COROTATIONAL, SFEM_STVK, SFEM_NEOHOOKEAN};
    int kind, l, held, k;
    (void)state;
    for (l = 0; l < 3; ++l)
        for (kind = 0; kind < 3; ++kind)
            for (held = 0; held < 2; ++held) {
                scene s = bar(6, 2, law[l], kind ? 1e5 : 1e6, 0);
                const size_t n = 3 * (size_t)s.mesh.nodes;
                double *u = (double *)calloc(2 * n, sizeof *u), *v = u + n, scale, first;
                test_random random = {(uint64_t)(1 + kind)};
                sfem_body_def def = soft(0);
                sfem_energy e;
                sfem_error err;
                sfem_int i;
                def.refactorise = 1;
                if (kind != 2) def.accuracy = 1;
                def.mass_damping = kind == 2 ? 0.1 : 0;
                def.stiffness_damping = kind == 2 ? 1e-3 : 0;
                add_body(&s, def, held);
                for (i = 0; i < s.mesh.nodes; ++i) {
                    const double x = s.mesh.x[3 * i];
                    if (kind == 0) v[3 * i + 1] = 12 * (x - 1); /* spun */
                    if (kind == 1) u[3 * i] = -0.6 * x;         /* squeezed */
                }
                if (kind == 2) random_fill(&random, v, n, -6, 6);
                assert_ok(sfem_body_set_state(s.body, u, v, &err), err);
                run(s.body, 1);
                e = sfem_body_energy(s.body);
                first = e.conserved;
                scale = s.body->state.head->scale;
                for (k = 0; k < 200; ++k) {
                    if (!sfem_body_get_refactorisation(s.body).running) refactorise(s.body);
                    run(s.body, 1);
                    e = sfem_body_energy(s.body);
                    assert_true(sfemi_finite(e.total) && e.conserved < first + scale);
                }
                assert_true(sfem_body_get_refactorisation(s.body).made > 2);
                free(u);
                drop(&s);
            }
}

static void handles_stay_where_they_are_held(void **state)
{
    scene s = bar(8, 2, SFEM_COROTATIONAL, 1e5, 0);
    sfem_real x[3], target[3];
    sfem_int handle[2];
    sfem_error err;
    int k, c;
    (void)state;
    add_body(&s, soft(0.5), 1);
    run(s.body, 5);
    assert_ok(sfem_body_grab_node(s.body, s.mesh.nodes - 1, handle, &err), err);
    {
        const sfem_real bary[4] = {0.1, 0.2, 0.3, 0.4};
        assert_ok(sfem_body_grab_point(s.body, s.mesh.tets / 2, bary, handle + 1, &err), err);
    }
    for (k = 0; k < 120; ++k) {
        if (!sfem_body_get_refactorisation(s.body).running) refactorise(s.body);
        sfem_body_handle_position(s.body, handle[0], target);
        target[2] += 0.005;
        assert_ok(sfem_body_move_handle(s.body, handle[0], target, &err), err);
        run(s.body, 1);
        sfem_body_handle_position(s.body, handle[0], x);
        for (c = 0; c < 3; ++c) assert_near(x[c], target[c], 0, 1e-9);
    }
    assert_true(sfem_body_get_refactorisation(s.body).made > 2);
    drop(&s);
}

/* --------------------------------------------------------------------------------------------
 * bits, memory, states, errors
 * -------------------------------------------------------------------------------------------- */

static void runs_repeat_on_any_number_of_threads(void **state)
{
    uint64_t first = 0;
    int threads;
    (void)state;
    for (threads = 1; threads <= 4; ++threads) {
        scene s = bar(12, 4, SFEM_COROTATIONAL, 1e5, 0);
        sfem_body_def def = soft(1);
        int k;
        if (threads > 1) def.exec = thread_exec(threads - 1);
        add_body(&s, def, 1);
        for (k = 0; k < 60; ++k) {
            if (!sfem_body_get_refactorisation(s.body).running) refactorise(s.body);
            run(s.body, 1);
        }
        assert_true(sfem_body_get_refactorisation(s.body).made >= 2);
        if (threads == 1) first = bits(s.body);
        assert_true(bits(s.body) == first);
        drop(&s);
    }
}

static void steps_and_new_factors_allocate_nothing(void **state)
{
    scene s = bar(6, 2, SFEM_COROTATIONAL, 1e5, 0);
    test_memory memory = {0};
    sfem_model_def model = linear_model_def();
    sfem_body_def def = soft(0.5);
    sfem_int handle = -1;
    sfem_error err;
    size_t calls;
    int k;
    (void)state;
    sfem_model_free(s.model);
    model.mesh = &s.mesh;
    model.material.law = SFEM_COROTATIONAL;
    model.material.young = 1e5;
    model.allocator = test_allocator(&memory);
    assert_ok(sfem_model_create(&model, &s.model, &err), err);
    def.may_allocate = 0;
    def.max_handles = 2;
    def.allocator = test_allocator(&memory);
    add_body(&s, def, 1);
    calls = memory.calls;
    for (k = 0; k < 100; ++k) {
        if (k == 20) assert_ok(sfem_body_grab_node(s.body, s.mesh.nodes - 1, &handle, &err), err);
        if (k == 60) sfem_body_release_handle(s.body, handle);
        if (!sfem_body_get_refactorisation(s.body).running) refactorise(s.body);
        run(s.body, 1);
    }
    assert_true(sfem_body_get_refactorisation(s.body).made > 2);
    assert_int_equal(memory.calls, calls);
    drop(&s);
    assert_no_leak(memory);
}

static sfem_status prepare_and_refactorise(sfem_allocator allocator, void *user, sfem_error *err)
{
    const sfem_mesh *mesh = (const sfem_mesh *)user;
    sfem_model_def def = linear_model_def();
    sfem_body_def body = soft(1e12);
    sfem_model *model = NULL;
    sfem_body *b = NULL;
    sfem_status status;
    int k;
    def.mesh = mesh;
    def.material.law = SFEM_COROTATIONAL;
    def.allocator = body.allocator = allocator;
    status = sfem_model_create(&def, &model, err);
    if (status == SFEM_OK) status = sfem_body_create(model, &body, &b, err);
    if (status == SFEM_OK) {
        status = sfem_body_prepare(b, H, err);
        if (status != SFEM_OK && b) assert_true(!b->factor && !b->refactor.source);
    }
    for (k = 0; k < 3 && status == SFEM_OK; ++k) {
        status = sfem_body_refactorise(b, NULL, err);
        if (status == SFEM_OK) status = sfem_body_step(b, H, err);
    }
    sfem_body_free(b);
    sfem_model_free(model);
    return status;
}

static void every_allocation_may_fail(void **state)
{
    scene s = bar(2, 1, SFEM_COROTATIONAL, 1e6, 0);
    (void)state;
    fail_every_allocation(prepare_and_refactorise, &s.mesh);
    drop(&s);
}

/* Where the new factor is dropped as the state is saved, all go on with the same bits. */
static void a_loaded_state_goes_on_with_the_first_factor(void **state)
{
    scene s = bar(6, 2, SFEM_COROTATIONAL, 1e5, 0), other;
    sfem_error err;
    size_t size;
    void *block;
    uint64_t mine;
    (void)state;
    other = s;
    add_body(&s, soft(1e12), 1);
    add_body(&other, soft(1e12), 1);
    run(s.body, 10);
    refactorise(s.body);
    run(s.body, 10);
    assert_true(sfem_body_get_refactorisation(s.body).in_use);
    size = sfem_body_state_size(s.body);
    block = malloc(size);
    sfem_body_save_state(s.body, block);
    sfem_body_drop_refactorisation(s.body);
    assert_false(sfem_body_get_refactorisation(s.body).in_use);
    run(s.body, 10);
    mine = bits(s.body);
    run(other.body, 3);
    refactorise(other.body);
    run(other.body, 3);
    assert_ok(sfem_body_load_state(other.body, block, size, &err), err);
    assert_false(sfem_body_get_refactorisation(other.body).in_use);
    run(other.body, 10);
    assert_true(bits(other.body) == mine);
    refactorise(s.body); /* other pins, another step, another state: dropped too */
    run(s.body, 1);
    assert_true(sfem_body_get_refactorisation(s.body).in_use);
    assert_ok(sfem_body_step(s.body, H / 2, &err), err);
    assert_false(sfem_body_get_refactorisation(s.body).in_use);
    run(s.body, 1);
    refactorise(s.body);
    assert_ok(sfem_body_set_pins(s.body, 3, s.pins, NULL, &err), err);
    run(s.body, 2);
    assert_false(sfem_body_get_refactorisation(s.body).in_use);
    refactorise(s.body);
    run(s.body, 1);
    assert_true(sfem_body_get_refactorisation(s.body).in_use);
    assert_ok(sfem_body_set_state(s.body, NULL, NULL, &err), err);
    assert_false(sfem_body_get_refactorisation(s.body).in_use);
    free(block);
    drop_body(&other);
    drop(&s);
}

static void what_cannot_be_refactorised_is_refused(void **state)
{
    scene s = bar(4, 1, SFEM_COROTATIONAL, 1e6, 0), other = bar(4, 2, SFEM_COROTATIONAL, 1e6, 0);
    scene linear = bar(4, 1, SFEM_LINEAR, 1e6, 0);
    sfem_body_def def = soft(-1);
    sfem_error err;
    sfem_matrix k;
    sfem_int i;
    uint64_t before;
    (void)state;
    assert_status(sfem_body_create(s.model, &def, &s.body, &err), SFEM_BAD_ARGUMENT);
    assert_names(err, "refactorise");
    def.refactorise = 0;
    add_body(&s, def, 1);
    assert_status(sfem_body_refactorise(s.body, NULL, &err), SFEM_BAD_ARGUMENT);
    drop_body(&s);
    def.refactorise = 1e12;
    add_body(&linear, def, 1);
    assert_status(sfem_body_refactorise(linear.body, NULL, &err), SFEM_BAD_ARGUMENT);
    assert_ok(sfem_body_create(s.model, &def, &s.body, &err), err);
    assert_status(sfem_body_refactorise(s.body, NULL, &err), SFEM_NOT_PREPARED);
    drop_body(&s);
    add_body(&s, def, 1);
    run(s.body, 3);
    assert_status(sfem_body_refactorise(s.body, sfem_model_stiffness(other.model), &err),
                  SFEM_BAD_ARGUMENT);
    assert_ok(sfem_model_combine(s.model, 1, 0, 0, NULL, &k, &err), err);
    k.val[9 * k.row[7]] = NAN;
    assert_status(sfem_body_refactorise(s.body, &k, &err), SFEM_NOT_FINITE);
    assert_int_equal(err.node, 7);
    for (i = 0; i < 9 * k.row[k.n]; ++i) k.val[i] = -s.model->stiffness.val[i];
    assert_ok(sfem_body_refactorise(s.body, &k, &err),
              err); /* not positive definite: found out on the way */
    run(s.body, 1);
    assert_int_equal(sfem_body_get_refactorisation(s.body).failed, 1);
    assert_true(!sfem_body_get_refactorisation(s.body).in_use && !sfem_body_get_refactorisation(s.body).running);
    run(s.body, 10);
    before = bits(s.body);
    drop_body(&s);
    add_body(&s, def, 1);
    run(s.body, 14);
    assert_true(bits(s.body) == before); /* nothing was changed by all that */
    sfem_matrix_free(&k);
    drop(&linear);
    drop(&other);
    drop(&s);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(slices_have_the_bits_of_one_stroke),
        cmocka_unit_test(a_factor_is_swapped_whole_after_the_counted_steps),
        cmocka_unit_test(a_body_that_was_only_rotated_gets_its_old_factor),
        cmocka_unit_test(a_matrix_of_the_callers_is_taken),
        cmocka_unit_test(a_stretched_string_swings_as_by_newton),
        cmocka_unit_test(costly_corrections_call_for_a_factor),
        cmocka_unit_test(a_calm_bar_keeps_its_factor),
        cmocka_unit_test(violence_makes_no_energy_through_new_factors),
        cmocka_unit_test(handles_stay_where_they_are_held),
        cmocka_unit_test(runs_repeat_on_any_number_of_threads),
        cmocka_unit_test(steps_and_new_factors_allocate_nothing),
        cmocka_unit_test(every_allocation_may_fail),
        cmocka_unit_test(a_loaded_state_goes_on_with_the_first_factor),
        cmocka_unit_test(what_cannot_be_refactorised_is_refused),
    };
    return run_all_tests(tests);
}
