/* Bodies that break while they step: energies, momenta, pieces, stability with the factor of the whole body,
 * states, threads, memory. */
#define SFEM_STATIC
#define SOFTFEM_IMPLEMENTATION
#include "support.h"
#ifdef STUB
#include "/tmp/stub_damage.c"
#endif

/* --------------------------------------------------------------------------------------------
 * scenes
 * -------------------------------------------------------------------------------------------- */

enum { MAX_NODES = 700 };

typedef struct scene {
    sfem_mesh mesh;
    sfem_model *model;
    sfem_body *body;
    sfem_int pins[128], n; /* the face at x = 0; nodes */
    sfem_int pin_count;
} scene;

static sfem_material glass(sfem_law law, double young)
{
    sfem_material m = sfem_default_material();
    m.young = young;
    m.law = law;
    return m;
}

/* A bar along x of cells of a tenth of a metre, its inner nodes moved a little. */
static scene bar(sfem_int nx, sfem_int ny, sfem_int nz, sfem_material material)
{
    sfem_int cells[3];
    sfem_real size[3];
    sfem_model_def def = sfem_default_model_def();
    test_random random = {11};
    sfem_error err;
    sfem_int i;
    int c;
    scene s;
    memset(&s, 0, sizeof s);
    cells[0] = nx, cells[1] = ny, cells[2] = nz;
    for (c = 0; c < 3; ++c) size[c] = 0.1 * cells[c];
    assert_ok(sfem_mesh_block(cells, size, SFEM_CELL_5_TETS, NULL, &s.mesh, &err), err);
    for (i = 0; i < s.mesh.nodes; ++i)
        if (s.mesh.x[3 * i] < 1e-9) s.pins[s.pin_count++] = i;
    for (i = 0; i < 3 * s.mesh.nodes; ++i) s.mesh.x[i] += random_uniform(&random, -0.01, 0.01);
    s.n = s.mesh.nodes;
    assert_true(s.n <= MAX_NODES);
    def.mesh = &s.mesh;
    def.material = material;
    assert_ok(sfem_model_create(&def, &s.model, &err), err);
    return s;
}

static void add_body(scene *s, sfem_body_def def, const sfem_damage_def *damage, int held)
{
    sfem_error err;
    def.damage = damage;
    if (held) {
        def.pins = s->pins;
        def.pin_count = s->pin_count;
    }
    assert_ok(sfem_body_create(s->model, &def, &s->body, &err), err);
}

static void drop(scene *s)
{
    sfem_body_free(s->body);
    sfem_model_free(s->model);
    sfem_mesh_free(&s->mesh);
    memset(s, 0, sizeof *s);
}

static void step(sfem_body *body, double h)
{
    sfem_error err;
    assert_ok(sfem_body_step(body, h, &err), err);
}

static void run(sfem_body *body, double h, int steps)
{
    while (steps-- > 0) step(body, h);
}

static void cross(const double *a, const double *b, double *out)
{
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

/* v = velocity + spin x (X - centre) + stretch (X - centre) */
static void set_motion(scene *s, const double *velocity, const double *spin, double stretch)
{
    double v[3 * MAX_NODES], centre[3] = {0, 0, 0};
    sfem_error err;
    sfem_int i;
    int c;
    for (i = 0; i < 3 * s->n; ++i) centre[i % 3] += s->mesh.x[i] / s->n;
    for (i = 0; i < s->n; ++i) {
        double r[3];
        for (c = 0; c < 3; ++c) r[c] = s->mesh.x[3 * i + c] - centre[c];
        cross(spin, r, v + 3 * i);
        for (c = 0; c < 3; ++c) v[3 * i + c] += velocity[c] + stretch * r[c];
    }
    assert_ok(sfem_body_set_state(s->body, NULL, v, &err), err);
}

static void shake(scene *s, double speed, uint64_t seed)
{
    double v[3 * MAX_NODES];
    test_random random = {seed};
    sfem_error err;
    random_fill(&random, v, 3 * (size_t)s->n, -speed, speed);
    assert_ok(sfem_body_set_state(s->body, NULL, v, &err), err);
}

/* Tells every edge to break that joins the nodes left of x = plane with those right of it. */
static sfem_int split(scene *s, double plane)
{
    const sfemi_bonds *g = s->body->bonds;
    sfem_int k, count = 0;
    sfem_error err;
    for (k = 0; k < g->edges; ++k) {
        const sfem_int i = g->end[2 * k], j = g->end[2 * k + 1];
        if ((s->mesh.x[3 * i] < plane) == (s->mesh.x[3 * j] < plane)) continue;
        assert_ok(sfem_body_break_edge(s->body, i, j, &err), err);
        ++count;
    }
    return count;
}

static double dot(const double *a, const double *b, size_t n)
{
    double sum = 0;
    size_t i;
    for (i = 0; i < n; ++i) sum += a[i] * b[i];
    return sum;
}

static sfem_damage_def brittle(double toughness)
{
    sfem_damage_def d = sfem_default_damage_def();
    d.toughness = toughness;
    return d;
}

/* so that nothing breaks but what is told to */
static sfem_damage_def on_request(void)
{
    sfem_damage_def d = sfem_default_damage_def();
    d.line_only = 1;
    return d;
}

static double largest_omega(scene *s)
{
    sfem_error err;
    assert_ok(sfemi_pqr_find_omega(s->body, &err), err);
    return s->body->omega_max;
}

/* --------------------------------------------------------------------------------------------
 * linear bodies
 * -------------------------------------------------------------------------------------------- */

/* With frames and projection off, A is M + p h^2 K of the whole body for good:
 * 1/2 w'.A w' + (Psi + Psi')/2 - (u'-u).(f'-f)/4. */
static double invariant(const scene *s, const double *u0, double h)
{
    const sfemi_state *t = &s->body->state;
    const size_t n = 3 * (size_t)s->n;
    const double *mass = sfem_model_node_mass(s->model);
    double kw[3 * MAX_NODES], e = 0;
    size_t i;
    sfem_model_multiply_stiffness(s->model, t->w, kw, NULL);
    for (i = 0; i < n; ++i) {
        e += t->w[i] * (mass[i / 3] * t->w[i] + s->body->p * h * h * kw[i]) / 2;
        e += (u0[i] * t->f_past[i] + t->u[i] * t->f[i]) / 4 - (t->u[i] - u0[i]) * (t->f[i] - t->f_past[i]) / 4;
    }
    return e;
}

static void no_break_raises_the_invariant_of_a_linear_body(void **state)
{
    const double omega[4] = {1, 10, 100, 1000}, toughness[4] = {20, 10, 0.1, 1e-3};
    int k, held, i;
    (void)state;
    for (held = 0; held < 2; ++held)
        for (k = 0; k < 4; ++k) {
            sfem_body_def def = sfem_default_body_def();
            const sfem_damage_def damage = brittle(toughness[k]);
            scene s = bar(6, 2, 2, glass(SFEM_LINEAR, 1e6));
            double before = 0, first = 0, h, released = 0;
            sfem_fracture f;
            def.frame = SFEM_FRAME_REST;
            add_body(&s, def, &damage, held);
            h = omega[k] / largest_omega(&s);
            shake(&s, 10, 5);
            for (i = 0; i < 400; ++i) {
                double u0[3 * MAX_NODES], now, fallen;
                memcpy(u0, sfem_body_displacement(s.body), 3 * (size_t)s.n * sizeof *u0);
                step(s.body, h);
                now = invariant(&s, u0, h);
                fallen = s.body->damage->account[SFEMI_RELEASED] - released;
                released += fallen;
                assert_true(fallen >= 0);
                if (i == 0) first = now;
                else assert_near(now, before - fallen, 0, 1e-11 * first);
                before = now;
            }
            f = sfem_body_fracture(s.body);
            printf("held %d omega h %g: broken %d pieces %d, invariant %g -> %g\n", held, omega[k], f.broken, f.pieces,
                   first, before);
            assert_true(f.broken >= 100);
            assert_near(s.body->p, 0.25, 0, 0);
            drop(&s);
        }
}

/* x = m^-1 b, m symmetric positive definite [n][n], overwritten. */
static void dense_solve(double *m, int n, double *x)
{
    int i, j, k;
    for (j = 0; j < n; ++j) {
        for (k = 0; k < j; ++k) m[j * n + j] -= m[j * n + k] * m[j * n + k];
        m[j * n + j] = sqrt(m[j * n + j]);
        for (i = j + 1; i < n; ++i) {
            for (k = 0; k < j; ++k) m[i * n + j] -= m[i * n + k] * m[j * n + k];
            m[i * n + j] /= m[j * n + j];
        }
    }
    for (i = 0; i < n; ++i) {
        for (k = 0; k < i; ++k) x[i] -= m[i * n + k] * x[k];
        x[i] /= m[i * n + i];
    }
    for (i = n - 1; i >= 0; --i) {
        for (k = i + 1; k < n; ++k) x[i] -= m[k * n + i] * x[k];
        x[i] /= m[i * n + i];
    }
}

/* w.A w, A by its inverse, which is what the body solves with. */
static double inertia(scene *s, const double *w)
{
    static double inverse[96 * 96];
    const int n = 3 * s->n;
    double x[3 * MAX_NODES];
    int i, j;
    assert_true(n <= 96);
    for (j = 0; j < n; ++j) {
        memset(x, 0, sizeof x);
        x[j] = 1;
        sfemi_turn_locate(s->body, s->body->state.u);
        sfemi_turn_solve(s->body, s->body->factor, s->body->state.u, s->body->state.frame, x);
        for (i = 0; i < n; ++i) inverse[i * n + j] = x[i];
    }
    memcpy(x, w, (size_t)n * sizeof *x);
    dense_solve(inverse, n, x);
    return dot(x, w, (size_t)n);
}

/* The projection of new pieces takes inertia away: the invariant, with A as it is now, falls by what
 * breaks release and not less. */
static void new_pieces_do_not_raise_the_invariant_either(void **state)
{
    const double omega[3] = {1, 30, 1000}, toughness[3] = {20, 1, 1e-3}, spin[3] = {0, 0, 0}, v[3] = {1, 0, 0};
    int k, i;
    (void)state;
    for (k = 0; k < 3; ++k) {
        sfem_body_def def = sfem_default_body_def();
        const sfem_damage_def damage = brittle(toughness[k]);
        scene s = bar(5, 1, 1, glass(SFEM_LINEAR, 1e6));
        double before = 0, first = 0, h, released = 0;
        sfem_int pieces = 1;
        add_body(&s, def, &damage, 0);
        h = omega[k] / largest_omega(&s);
        set_motion(&s, v, spin, 2);
        shake(&s, 10, 7);
        for (i = 0; i < 300; ++i) {
            double u0[3 * MAX_NODES], now, fallen;
            const sfemi_state *t = &s.body->state;
            size_t c;
            memcpy(u0, sfem_body_displacement(s.body), 3 * (size_t)s.n * sizeof *u0);
            step(s.body, h);
            now = inertia(&s, t->w) / 2;
            for (c = 0; c < 3 * (size_t)s.n; ++c)
                now += (u0[c] * t->f_past[c] + t->u[c] * t->f[c]) / 4 -
                       (t->u[c] - u0[c]) * (t->f[c] - t->f_past[c]) / 4;
            fallen = s.body->damage->account[SFEMI_RELEASED] - released;
            released += fallen;
            if (i == 0) first = now;
            else if (s.body->turn.pieces == pieces) assert_near(now, before - fallen, 0, 1e-9 * first);
            else assert_true(now <= before - fallen + 1e-9 * first);
            pieces = s.body->turn.pieces;
            before = now;
        }
        printf("omega h %g: broken %d pieces %d, invariant %g -> %g\n", omega[k],
               sfem_body_fracture(s.body).broken, pieces, first, before);
        assert_true(pieces >= 4);
        drop(&s);
    }
}

/* The clamped bar of which the right half is cut off and falls. */
static double fall_of_the_free_half(double young, sfem_frame frame, sfem_law law)
{
    sfem_body_def def = sfem_default_body_def();
    const sfem_damage_def damage = on_request();
    scene s = bar(8, 2, 2, glass(law, young));
    const double g[3] = {0, 0, -9.81};
    sfem_piece piece[2];
    double z;
    sfem_error err;
    def.frame = frame;
    add_body(&s, def, &damage, 1);
    split(&s, 0.45);
    step(s.body, 1.0 / 60);
    assert_int_equal(sfem_body_fracture(s.body).pieces, 2);
    sfem_body_pieces(s.body, piece);
    assert_ok(sfem_body_set_gravity(s.body, g, &err), err);
    assert_ok(sfem_body_set_state(s.body, NULL, NULL, &err), err);
    z = piece[1].centre[2];
    run(s.body, 1.0 / 60, 15);
    sfem_body_pieces(s.body, piece);
    assert_int_equal(sfem_body_fracture(s.body).pieces, 2);
    z -= piece[1].centre[2];
    drop(&s);
    return z;
}

static void a_cut_bar_falls_as_it_should_only_with_the_projection(void **state)
{
    const double young[3] = {1e4, 1e6, 1e8}, slow[3] = {1.002, .9, .1};
    int k, law;
    (void)state;
    for (k = 0; k < 3; ++k)
        for (law = 0; law < 2; ++law) {
            const double fall = fall_of_the_free_half(young[k], SFEM_FRAME_NODE, law ? SFEM_COROTATIONAL : SFEM_LINEAR);
            const double stale = fall_of_the_free_half(young[k], SFEM_FRAME_REST, SFEM_LINEAR);
            printf("Y %g: fall %.4f stale %.4f\n", young[k], fall, stale);
            assert_near(fall, 9.81 * 0.25 * 0.25 / 2, 1e-9, 0);
            assert_true(stale < slow[k] * fall);
        }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(no_break_raises_the_invariant_of_a_linear_body),
        cmocka_unit_test(new_pieces_do_not_raise_the_invariant_either),
        cmocka_unit_test(a_cut_bar_falls_as_it_should_only_with_the_projection),
    };
    return run_all_tests(tests);
}
