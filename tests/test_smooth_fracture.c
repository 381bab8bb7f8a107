/* Smooth tets that break: K of what is left stays below K0, forces are the energy's gradient, breaks are booked at what
 * they do, states and threads leave the same bits. */
#define SFEM_STATIC
#define SFEM_MINIMAL
#define SFEM_ENABLE_DAMAGE
#define SFEM_ENABLE_SMOOTH
#define SOFTFEM_IMPLEMENTATION
#include "support.h"

enum { MAX_NODES = 500 };

typedef struct scene {
    sfem_mesh mesh;
    sfem_model *model;
    sfem_body *body;
    sfem_int pins[64], pin_count;
} scene;

static sfem_damage_def brittle(double toughness)
{
    sfem_damage_def d = sfem_default_damage_def();
    d.toughness = toughness;
    return d;
}

/* mesh 0: five-tet cells, 1: six-tet cells, both with their nodes moved a little, 2: a ball */
static scene make(int mesh, int nx, sfem_law law, double poisson, sfem_body_def def, const sfem_damage_def *damage,
                  int held)
{
    const sfem_int cells[3] = {nx, 2, 2};
    const double size[3] = {0.1 * nx, 0.2, 0.2};
    sfem_model_def model_def = sfem_default_model_def();
    test_random random = {11};
    sfem_error err;
    sfem_int i;
    scene s;
    memset(&s, 0, sizeof s);
    if (mesh == 2) assert_ok(sfem_mesh_ball(0.2, 3, NULL, &s.mesh, &err), err);
    else
        assert_ok(sfem_mesh_block(cells, size, mesh ? SFEM_CELL_6_TETS : SFEM_CELL_5_TETS, NULL, &s.mesh, &err), err);
    for (i = 0; i < s.mesh.nodes; ++i)
        if (held && s.mesh.x[3 * i] < 1e-9) s.pins[s.pin_count++] = i;
    for (i = 0; mesh < 2 && i < 3 * s.mesh.nodes; ++i) s.mesh.x[i] += random_uniform(&random, -0.01, 0.01);
    assert_true(s.mesh.nodes <= MAX_NODES);
    model_def.mesh = &s.mesh;
    model_def.material.law = law;
    model_def.material.poisson = poisson;
    model_def.material.tet = SFEM_TET_SMOOTH;
    assert_ok(sfem_model_create(&model_def, &s.model, &err), err);
    def.damage = damage;
    def.pins = s.pins;
    def.pin_count = s.pin_count;
    assert_ok(sfem_body_create(s.model, &def, &s.body, &err), err);
    return s;
}

static void drop(scene *s)
{
    sfem_body_free(s->body);
    sfem_model_free(s->model);
    sfem_mesh_free(&s->mesh);
}

static void run(sfem_body *body, double h, int steps)
{
    sfem_error err;
    while (steps-- > 0) assert_ok(sfem_body_step(body, h, &err), err);
}

/* part > 0: that part of the edges, at random; 0: a crack halfway through, across the longest axis */
static void break_edges(scene *s, double part)
{
    sfemi_damage *d = s->body->damage;
    const sfemi_bonds *g = d->bonds;
    test_random random = {5};
    double low = 1e300, high = -1e300, middle;
    sfem_int k, i;
    for (i = 0; i < s->mesh.nodes; ++i) {
        low = fmin(low, s->mesh.x[3 * i]);
        high = fmax(high, s->mesh.x[3 * i]);
    }
    middle = low + 0.47 * (high - low);
    for (k = 0; k < g->edges; ++k) {
        const double *a = s->mesh.x + 3 * g->end[2 * k], *b = s->mesh.x + 3 * g->end[2 * k + 1];
        const int crosses = (a[0] - middle) * (b[0] - middle) < 0 && a[1] + b[1] < 0.22;
        if (part > 0 ? random_uniform(&random, 0, 1) < part : crosses) d->zeta[k] = 0;
    }
    sfemi_damage_refresh(d);
}

/* ---- the bound ---- */

/* Is most K0 - K positive semidefinite, in dense matrices? Rounding and rigid motions: plus 1e-7 of the diagonal. */
static int bounds(const scene *s, double most)
{
    const size_t n = 3 * (size_t)s->mesh.nodes;
    double *a = (double *)calloc(n * n, sizeof *a), *x = (double *)calloc(n, sizeof *x);
    double *k = (double *)calloc(n, sizeof *k), *k0 = (double *)calloc(n, sizeof *k0), size = 0;
    sfem_matrix upper;
    sfem_error err;
    size_t i, j;
    int good;
    assert_ok(sfem_model_combine(s->model, 1, 0, 0, NULL, &upper, &err), err);
    for (j = 0; j < n; ++j) {
        x[j] = 1;
        sfem_matrix_multiply(&upper, x, k0, NULL);
        assert_true(sfemi_damage_multiply_left(s->body->damage, x, k));
        for (i = 0; i < n; ++i) a[n * i + j] = most * k0[i] - k[i];
        size = fmax(size, k0[j]);
        x[j] = 0;
    }
    for (i = 0; i < n; ++i) a[(n + 1) * i] += 1e-7 * size;
    good = sfem_dense_cholesky((sfem_int)n, a, NULL) == SFEM_OK;
    sfem_matrix_free(&upper);
    free(a), free(x), free(k), free(k0);
    return good;
}

static void what_is_left_stays_below_k0(void **state)
{
    static const double part[3] = {0, 0.1, 0.3}, poisson[2] = {0.3, 0.499};
    int mesh, how, nu, below = 0;
    (void)state;
    for (mesh = 0; mesh < 3; ++mesh)
        for (how = 0; how < 3; ++how)
            for (nu = 0; nu < 2; ++nu) {
                const sfem_damage_def damage = brittle(100);
                scene s = make(mesh, 5, SFEM_COROTATIONAL, poisson[nu], sfem_default_body_def(), &damage, 0);
                assert_true(bounds(&s, 1.0001));
                below += !bounds(&s, 0.9);
                break_edges(&s, part[how]);
                assert_true(s.body->damage->tets > 5);
                assert_true(bounds(&s, 1.0001));
                below += !bounds(&s, 0.5);
                drop(&s);
            }
    assert_int_equal(below, 36); /* the bound is not idle */
}

/* ---- forces ---- */

static void forces_are_the_gradient_of_the_energy(void **state)
{
    int law, mesh, i;
    (void)state;
    for (mesh = 0; mesh < 3; ++mesh)
        for (law = SFEM_COROTATIONAL; law <= SFEM_NEOHOOKEAN; law += SFEM_NEOHOOKEAN - SFEM_COROTATIONAL) {
            const sfem_damage_def damage = brittle(100);
            scene s = make(mesh, 4, (sfem_law)law, 0.45, sfem_default_body_def(), &damage, 0);
            double u[3 * MAX_NODES], way[3 * MAX_NODES], f[3 * MAX_NODES], g[3 * MAX_NODES], slope = 0, e[2], size = 0;
            const int n = 3 * s.mesh.nodes;
            test_random random = {3};
            random_fill(&random, u, (size_t)n, -0.004, 0.004);
            random_fill(&random, way, (size_t)n, -1, 1);
            break_edges(&s, 0.1);
            sfemi_safeguard_forces(s.body, u, f);
            for (i = 0; i < n; ++i) {
                slope += f[i] * way[i];
                size += f[i] * f[i];
            }
            for (i = 0; i < n; ++i) u[i] += 1e-6 * way[i];
            e[1] = sfemi_safeguard_forces(s.body, u, g);
            for (i = 0; i < n; ++i) u[i] -= 2e-6 * way[i];
            e[0] = sfemi_safeguard_forces(s.body, u, g);
            assert_near((e[1] - e[0]) / 2e-6, slope, 0, 1e-6 * sqrt(size * n));
            assert_true(size > 0);
            drop(&s);
        }
}

/* What breaks have booked is what the energy and the forces of the damaged body are, step by step. */
static void forces_after_breaks_are_those_of_the_damaged_body(void **state)
{
    int law, i, k;
    (void)state;
    for (law = SFEM_COROTATIONAL; law <= SFEM_NEOHOOKEAN; law += SFEM_NEOHOOKEAN - SFEM_COROTATIONAL) {
        const sfem_damage_def damage = brittle(5);
        scene s = make(0, 8, (sfem_law)law, 0.4, sfem_default_body_def(), &damage, 0);
        double v[3 * MAX_NODES], f[3 * MAX_NODES];
        sfem_error err;
        for (i = 0; i < s.mesh.nodes; ++i) {
            const double *x = s.mesh.x + 3 * i, r[3] = {x[0] - 0.4, x[1] - 0.1, x[2] - 0.1};
            v[3 * i] = 4 * r[0] + 12 * r[2] + 3 * r[1];
            v[3 * i + 1] = 4 * r[1] - 3 * r[0] - 4 * r[2];
            v[3 * i + 2] = 4 * r[2] + 4 * r[1] - 12 * r[0];
        }
        assert_ok(sfem_body_set_state(s.body, NULL, v, &err), err);
        for (k = 0; k < 60; ++k) {
            double psi, size = 0;
            run(s.body, 1e-3, 1);
            psi = sfemi_safeguard_forces(s.body, s.body->state.u, f);
            for (i = 0; i < 3 * s.mesh.nodes; ++i) size += f[i] * f[i];
            assert_near(s.body->state.head->psi, psi, 1e-9, 1e-9);
            for (i = 0; i < 3 * s.mesh.nodes; ++i)
                assert_near(f[i], s.body->state.f[i], 0, 1e-8 * sqrt(size) + 1e-7);
        }
        assert_true(sfem_body_fracture(s.body).broken > 20);
        drop(&s);
    }
}

/* ---- bodies ---- */

/* A bar held at one end, pulled apart by its start. */
static scene thrown(sfem_body_def def, const sfem_damage_def *damage)
{
    scene s = make(1, 8, SFEM_COROTATIONAL, 0.45, def, damage, 1);
    double v[3 * MAX_NODES];
    sfem_error err;
    sfem_int i;
    for (i = 0; i < 3 * s.mesh.nodes; ++i) v[i] = i % 3 == 0 ? 12 * s.mesh.x[i] : 0;
    assert_ok(sfem_body_set_state(s.body, NULL, v, &err), err);
    return s;
}

static void states_and_threads_leave_the_same_bits(void **state)
{
    uint64_t bits[4] = {0, 0, 0, 0};
    int t;
    (void)state;
    for (t = 0; t < 4; ++t) { /* 3: saved and loaded on the way */
        sfem_body_def def = sfem_default_body_def();
        const sfem_damage_def damage = brittle(5);
        scene s;
        if (t == 1 || t == 2) def.exec = thread_exec(2 * t);
        s = thrown(def, &damage);
        run(s.body, 1e-3, 12);
        if (t == 3) {
            scene other = thrown(def, &damage);
            const size_t bytes = sfem_body_state_size(s.body);
            void *memory = malloc(bytes);
            sfem_error err;
            assert_true(sfem_body_fracture(s.body).broken > 0);
            sfem_body_save_state(s.body, memory);
            assert_ok(sfem_body_load_state(other.body, memory, bytes, &err), err);
            free(memory);
            drop(&s);
            s = other;
        }
        run(s.body, 1e-3, 28);
        assert_true(sfem_body_fracture(s.body).broken > 20);
        bits[t] = hash_reals(sfem_body_displacement(s.body), 3 * (size_t)s.mesh.nodes);
        drop(&s);
    }
    for (t = 1; t < 4; ++t) assert_true(bits[t] == bits[0]);
}

/* A free bar that is torn in flight keeps its momentum, and makes no energy: what is there at the end and what the
 * breaks released is at most what was there at first. */
static void a_torn_bar_keeps_momentum_and_makes_no_energy(void **state)
{
    static const double nu[2] = {0.3, 0.48};
    int k;
    (void)state;
    for (k = 0; k < 2; ++k) {
        const sfem_damage_def damage = brittle(5);
        scene s = make(1, 8, SFEM_COROTATIONAL, nu[k], sfem_default_body_def(), &damage, 0);
        double v[3 * MAX_NODES], now[3 * MAX_NODES], p[3] = {0, 0, 0}, mass = 0, first;
        const double *node_mass = sfem_model_node_mass(s.model);
        sfem_energy energy;
        sfem_error err;
        sfem_int i;
        int c;
        for (i = 0; i < s.mesh.nodes; ++i) {
            for (c = 0; c < 3; ++c) v[3 * i + c] = (c == 0 ? 16 * (s.mesh.x[3 * i] - 0.4) : 0) + 1;
            mass += node_mass[i];
        }
        assert_ok(sfem_body_set_state(s.body, NULL, v, &err), err);
        first = sfem_body_energy(s.body).total;
        for (i = 0; i < s.mesh.nodes; ++i)
            for (c = 0; c < 3; ++c) p[c] += node_mass[i] * v[3 * i + c];
        run(s.body, 1e-3, 200);
        energy = sfem_body_energy(s.body);
        sfem_body_velocities(s.body, now);
        for (i = 0; i < s.mesh.nodes; ++i)
            for (c = 0; c < 3; ++c) p[c] -= node_mass[i] * now[3 * i + c];
        for (c = 0; c < 3; ++c) assert_near(p[c], 0, 0, 1e-9 * mass);
        assert_true(sfem_body_fracture(s.body).broken > 20 && sfem_body_fracture(s.body).pieces > 1);
        assert_true(energy.total <= first * (1 + 1e-9));
        assert_true(energy.kinetic > 0.1 * first);
        drop(&s);
    }
}

static sfem_status attempt(sfem_allocator allocator, void *user, sfem_error *err)
{
    const sfem_damage_def damage = brittle(5);
    sfem_model_def model_def = sfem_default_model_def();
    sfem_body_def def = sfem_default_body_def();
    sfem_model *model = NULL;
    sfem_body *body = NULL;
    sfem_status status;
    model_def.mesh = (const sfem_mesh *)user;
    model_def.material.tet = SFEM_TET_SMOOTH;
    model_def.allocator = def.allocator = allocator;
    def.damage = &damage;
    status = sfem_model_create(&model_def, &model, err);
    if (status == SFEM_OK) status = sfem_body_create(model, &def, &body, err);
    if (status == SFEM_OK) status = sfem_body_step(body, 0.01, err);
    sfem_body_free(body);
    sfem_model_free(model);
    return status;
}

static void every_allocation_may_fail(void **state)
{
    const sfem_int cells[3] = {2, 1, 1};
    const double size[3] = {0.2, 0.1, 0.1};
    sfem_mesh mesh;
    sfem_error err;
    (void)state;
    assert_ok(sfem_mesh_block(cells, size, SFEM_CELL_6_TETS, NULL, &mesh, &err), err);
    assert_true(fail_every_allocation(attempt, &mesh) > 20);
    sfem_mesh_free(&mesh);
}

static void the_linear_law_is_refused(void **state)
{
    const sfem_damage_def damage = brittle(5);
    scene s = make(0, 2, SFEM_COROTATIONAL, 0.3, sfem_default_body_def(), &damage, 0);
    sfem_model_def model_def = sfem_default_model_def();
    sfem_body_def def = sfem_default_body_def();
    sfem_model *model;
    sfem_body *body;
    sfem_error err;
    (void)state;
    model_def.mesh = &s.mesh;
    model_def.material.tet = SFEM_TET_SMOOTH;
    model_def.material.law = SFEM_LINEAR;
    def.damage = &damage;
    assert_ok(sfem_model_create(&model_def, &model, &err), err);
    assert_status(sfem_body_create(model, &def, &body, &err), SFEM_BAD_ARGUMENT);
    assert_non_null(strstr(err.text, "SFEM_COROTATIONAL"));
    sfem_model_free(model);
    drop(&s);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(what_is_left_stays_below_k0),
        cmocka_unit_test(forces_are_the_gradient_of_the_energy),
        cmocka_unit_test(forces_after_breaks_are_those_of_the_damaged_body),
        cmocka_unit_test(states_and_threads_leave_the_same_bits),
        cmocka_unit_test(a_torn_bar_keeps_momentum_and_makes_no_energy),
        cmocka_unit_test(every_allocation_may_fail),
        cmocka_unit_test(the_linear_law_is_refused),
    };
    return run_all_tests(tests);
}
