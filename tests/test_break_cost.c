/* What bodies that can break cost, in counts: what a round of breaks looks at, and what is made again of a factor. */
#define SFEM_STATIC
#define SFEM_MINIMAL
#define SFEM_ENABLE_DAMAGE
#define SOFTFEM_IMPLEMENTATION
#include "support.h"

#define H (1.0 / 60)

enum { STEPS = 40 };

typedef struct scene {
    sfem_mesh mesh;
    sfem_model *model;
    sfem_int pins[512], pin_count;
} scene;

/* A bar along x, clamped at x = 0. */
static scene bar(sfem_int nx, sfem_int ny, sfem_block_cells cell, sfem_law law)
{
    const sfem_int cells[3] = {nx, ny, ny};
    const sfem_real size[3] = {1, (double)ny / nx, (double)ny / nx};
    sfem_model_def def = sfem_default_model_def();
    sfem_error err;
    sfem_int i;
    scene s;
    memset(&s, 0, sizeof s);
    assert_ok(sfem_mesh_block(cells, size, cell, NULL, &s.mesh, &err), err);
    for (i = 0; i < s.mesh.nodes; ++i)
        if (s.mesh.x[3 * i] < 1e-9) s.pins[s.pin_count++] = i;
    def.mesh = &s.mesh;
    def.material.law = law;
    def.material.young = 1e6;
    def.material.poisson = 0.3;
    assert_ok(sfem_model_create(&def, &s.model, &err), err);
    return s;
}

static void close_scene(scene *s)
{
    sfem_model_free(s->model);
    sfem_mesh_free(&s->mesh);
}

static sfem_body *hang(const scene *s, sfem_body_def def, const sfem_damage_def *damage)
{
    sfem_body *body = NULL;
    sfem_error err;
    def.pins = s->pins;
    def.pin_count = s->pin_count;
    def.gravity[2] = -20;
    def.damage = damage;
    assert_ok(sfem_body_create(s->model, &def, &body, &err), err);
    return body;
}

static void look_at_all(sfem_body *b)
{
    const sfemi_chunks *c = &b->model->chunks;
    memset(b->damage->near_limit, 1, (size_t)c->block_start[c->count]);
}

/* --------------------------------------------------------------------------------------------
 * what a round looks at
 * -------------------------------------------------------------------------------------------- */

/* Two bodies, one of which looks at every tet: the same bits after each step. Returns the least share of the tets that the
 * other one looked at in a step. */
static double compare(const scene *s, sfem_body_def def, const sfem_damage_def *damage, sfem_int *broken)
{
    const size_t n = 3 * (size_t)s->mesh.nodes;
    const sfem_real from[9] = {0.5, -1, -1, 0.5, 2, -1, 0.5, 0, 1}, to[9] = {0.52, -1, -1, 0.52, 2, -1, 0.52, 0, 2};
    sfem_body *b[2];
    sfem_error err;
    sfem_int least = s->mesh.tets, step;
    int k;
    for (k = 0; k < 2; ++k) b[k] = hang(s, def, damage);
    for (step = 0; step < STEPS; ++step) {
        for (k = 0; k < 2; ++k) {
            if (step == 8) assert_ok(sfem_body_cut(b[k], from, to, NULL, &err), err);
            if (k) look_at_all(b[k]);
            assert_ok(sfem_body_step(b[k], H, &err), err);
        }
        assert_int_equal(b[1]->damage->watched, s->mesh.tets);
        least = b[0]->damage->watched < least ? b[0]->damage->watched : least;
        assert_memory_equal(b[0]->state.u, b[1]->state.u, n * sizeof(sfem_real));
        assert_memory_equal(b[0]->state.w, b[1]->state.w, n * sizeof(sfem_real));
        assert_memory_equal(b[0]->state.damage, b[1]->state.damage, sfemi_damage_state_bytes(b[0]->bonds));
    }
    *broken += sfem_body_fracture(b[0]).broken;
    for (k = 0; k < 2; ++k) sfem_body_free(b[k]);
    return (double)least / s->mesh.tets;
}

static void what_is_not_looked_at_changes_no_bit(void **state)
{
    static const sfem_law laws[3] = {SFEM_LINEAR, SFEM_COROTATIONAL, SFEM_STVK};
    int law, criterion, variant;
    (void)state;
    for (law = 0; law < 3; ++law) {
        scene s = bar(8, 3, law == 1 ? SFEM_CELL_6_TETS : SFEM_CELL_5_TETS, laws[law]);
        double least = 1;
        sfem_int broken = 0;
        for (criterion = SFEM_BREAK_ENERGY; criterion <= SFEM_BREAK_DUCTILE; ++criterion)
            for (variant = 0; variant < 4; ++variant) {
                sfem_damage_def damage = sfem_default_damage_def();
                sfem_body_def def = sfem_default_body_def();
                if (variant && (law + criterion) % 3 != variant - 1) continue; /* some of each */
                damage.criterion = (sfem_damage_criterion)criterion;
                damage.toughness = 20;
                damage.strength = criterion == SFEM_BREAK_STRESS ? 1e5 : 0.1;
                damage.soften[0] = 0.06;
                damage.soften[1] = 0.15;
                def.precision = variant == 1 ? SFEM_MIXED : SFEM_DOUBLE;
                if (variant == 2) damage.law = SFEM_DAMAGE_ZSZ, def.p = 6;
                if (variant == 3) damage.closure = 1, def.p = 0.5;
                least = fmin(least, compare(&s, def, &damage, &broken));
            }
        assert_true(broken > 100);
        assert_true(least < 0.8);
        close_scene(&s);
    }
}

static void far_from_breaking_nothing_is_looked_at(void **state)
{
    static const sfem_law laws[4] = {SFEM_LINEAR, SFEM_COROTATIONAL, SFEM_STVK, SFEM_NEOHOOKEAN};
    sfem_error err;
    int k, step;
    (void)state;
    for (k = 0; k < 4; ++k) {
        scene s = bar(8, 3, SFEM_CELL_5_TETS, laws[k]);
        sfem_damage_def damage = sfem_default_damage_def();
        sfem_body *b;
        damage.toughness = 1e9;
        b = hang(&s, sfem_default_body_def(), &damage);
        for (step = 0; step < 10; ++step) {
            assert_ok(sfem_body_step(b, H, &err), err);
            /* all in the first round, which knows nothing of the step before; neo-Hookean tets have no bound */
            assert_int_equal(b->damage->watched, step == 0 || k == 3 ? s.mesh.tets : 0);
            assert_int_equal(b->damage->knowns > 0, step == 0 || k == 3);
            assert_int_equal(b->damage->nears, 0);
        }
        sfem_body_free(b);
        close_scene(&s);
    }
}

/* The bound itself, from energies and strains that are computed otherwise: tets deformed at random, also through each
 * other. */
static void a_tet_below_its_limit_is_below_its_threshold(void **state)
{
    static const sfem_law laws[3] = {SFEM_LINEAR, SFEM_COROTATIONAL, SFEM_STVK};
    static const double nu[3] = {-0.6, 0.3, 0.49};
    uint32_t random = 7;
    int k, m, a, c, tried = 0, below = 0, above = 0;
    sfem_int e, trial;
    (void)state;
    for (k = 0; k < 9; ++k) {
        sfem_damage_def damage = sfem_default_damage_def();
        const sfem_law law = laws[k % 3];
        const sfem_allocator plain = {0};
        sfem_model_def def = sfem_default_model_def();
        sfemi_bonds *g;
        sfem_error err;
        scene s = bar(3, 2, SFEM_CELL_6_TETS, law);
        sfem_model_free(s.model);
        def.mesh = &s.mesh;
        def.material.law = law;
        def.material.young = 1e6;
        def.material.poisson = nu[k / 3];
        for (e = 0; e < 3 * s.mesh.nodes; ++e) { /* some flat tets */
            random = random * 1664525u + 1013904223u;
            s.mesh.x[e] += 0.12 * ((double)random / 4294967296.0 - 0.5) / 3;
        }
        assert_ok(sfem_model_create(&def, &s.model, &err), err);
        damage.toughness = 3000;
        assert_ok(sfemi_bonds_create(s.model, &damage, &plain, &g, &err), err);
        for (e = 0; e < s.mesh.tets; ++e)
            for (trial = 0; trial < 300; ++trial) {
                sfem_real x[12], u[12], grad[9], g4[4][3], psi, square = 0;
                const double size = pow(10, -4 + 5.0 * trial / 300);
                sfemi_damage_gather(s.mesh.x, s.mesh.tet + 4 * e, x);
                for (a = 0; a < 12; ++a) {
                    random = random * 1664525u + 1013904223u;
                    u[a] = size * ((double)random / 4294967296.0 - 0.5);
                }
                (void)sfemi_element_gradients(&s.mesh, e, g4);
                sfemi_element_deform(u, u + 3, u + 6, u + 9, g4, grad);
                for (a = 0; a < 9; a += 4) grad[a] += 1;
                psi = s.model->volume[e] * sfem_law_energy(law, s.model->lambda[e], s.model->mu[e], grad);
                for (m = 0; m < 6; ++m) {
                    const int *end = sfemi_edge_ends(3, m);
                    double rest = 0, now = 0, along = 0;
                    for (c = 0; c < 3; ++c) {
                        const double r = x[3 * end[0] + c] - x[3 * end[1] + c], d = u[3 * end[0] + c] - u[3 * end[1] + c];
                        rest += r * r;
                        now += (r + d) * (r + d);
                        along += r * d;
                    }
                    square += law == SFEM_LINEAR ? along * along / (rest * rest)
                                                 : (sqrt(now / rest) - 1) * (sqrt(now / rest) - 1);
                }
                ++tried;
                if (psi < sfemi_bonds_limit(g, e)) {
                    ++below;
                    assert_true(square < g->threshold[e]);
                } else above += square < g->threshold[e];
            }
        sfemi_bonds_free(g);
        close_scene(&s);
    }
    assert_true(below > 10000);
    print_message("between limit and threshold: %.2f decades of strain\n", (double)above / tried * 5);
    assert_true((double)above / tried * 5 < 1.2); /* and it is no idle bound */
}

/* --------------------------------------------------------------------------------------------
 * what is made again of a factor
 * -------------------------------------------------------------------------------------------- */

/* Steps until the factor that is being made is in use. */
static void await_factor(sfem_body *b)
{
    sfem_error err;
    int step;
    for (step = 0; step < 400; ++step) {
        const int64_t made = sfem_body_get_refactorisation(b).made;
        assert_ok(sfem_body_step(b, H, &err), err);
        if (sfem_body_get_refactorisation(b).made > made) return;
    }
    fail_msg("no factor was made");
}

/* The factor in use is that of what is left, to the last bit: made at a stroke from all of K. */
static void check_factor(sfem_body *b)
{
    const sfemi_refactor *r = &b->refactor;
    const sfem_ldl *ldl = r->ldl[r->live - 1];
    const sfemi_symbolic *y = ldl->symbolic;
    const sfem_model *model = b->model;
    sfem_real *val = (sfem_real *)malloc(9 * (size_t)model->row[model->mesh.nodes] * sizeof *val);
    sfem_matrix a;
    sfem_ldl *whole;
    sfem_error err;
    sfem_int row, at;
    memcpy(val, model->stiffness.val, 9 * (size_t)model->row[model->mesh.nodes] * sizeof *val);
    sfemi_damage_add_stiffness(b->damage, 1, val);
    assert_memory_equal(val, r->k[r->live - 1].val, 9 * (size_t)model->row[model->mesh.nodes] * sizeof *val);
    a = r->a;
    a.val = (sfem_real *)calloc(9 * (size_t)a.row[a.n], sizeof *a.val);
    for (row = 0; row < a.n; ++row)
        for (at = a.row[row]; at < a.row[row + 1]; ++at) {
            int p;
            sfemi_fem_block(model, r->source[at], b->factor->node[row], 0, b->factor->key.cm, b->factor->key.cd,
                            a.val + 9 * (size_t)at);
            for (p = 0; p < 9; ++p)
                a.val[9 * (size_t)at + (size_t)p] += b->factor->key.ck * val[9 * (size_t)r->source[at] + (size_t)p];
        }
    assert_memory_equal(a.val, r->a.val, 9 * (size_t)a.row[a.n] * sizeof *val);
    assert_ok(sfem_ldl_create_like(ldl, &a, NULL, &whole, &err), err);
    assert_memory_equal(whole->l, ldl->l, y->panel[y->supernodes] * sizeof *ldl->l);
    assert_memory_equal(whole->scale, ldl->scale, 3 * (size_t)y->n * sizeof *ldl->scale);
    sfem_ldl_free(whole);
    free(a.val);
    free(val);
}

/* Cracks through the whole bar. What is made again is the path to the root of the elimination tree, which is short near
 * the root, here at the clamped end, and long far from it. */
static void a_crack_near_the_root_costs_a_fifth_of_a_factor(void **state)
{
    static const double place[4] = {0.11, 0.06, 0.16, 0.31};
    scene s = bar(40, 4, SFEM_CELL_5_TETS, SFEM_COROTATIONAL);
    sfem_damage_def damage = sfem_default_damage_def();
    sfem_body_def def = sfem_default_body_def();
    sfem_body *b;
    sfem_error err;
    double whole;
    int k;
    (void)state;
    damage.toughness = 1e12;
    def.refactorise = 4;
    b = hang(&s, def, &damage);
    b->state.head->gravity[2] = 0;
    assert_ok(sfem_body_prepare(b, H, &err), err);
    whole = sfemi_slice_total(b->refactor.ldl[0]);
    for (k = 0; k < 4; ++k) {
        const double x = place[k];
        const sfem_real from[9] = {x, -1, -1, x, 2, -1, x, 0, -0.5}, to[9] = {x, -1, -1, x, 2, -1, x, 0, 2};
        sfem_int marked;
        sfem_refactorisation info;
        assert_ok(sfem_body_cut(b, from, to, &marked, &err), err);
        await_factor(b);
        info = sfem_body_get_refactorisation(b);
        print_message("crack of %d edges at %.2f of a bar of 40 x 4 x 4 cells: %.3f of the operations of a whole factor\n",
                      (int)marked, x, info.flops / whole);
        assert_true(marked >= 60);
        assert_true(info.done <= 1.01 * info.flops && info.done >= 0.99 * info.flops);
        assert_true(info.flops <= (k < 3 ? 0.25 : 0.4) * whole); /* with what the other factor missed of the one before */
        if (k == 0) assert_true(info.flops <= 0.2 * whole);
        check_factor(b);
    }
    sfem_body_free(b);
    close_scene(&s);
}

/* What is interrupted, taken from the caller or healed is made whole the next time. */
static void a_factor_that_cannot_be_mended_is_made_whole(void **state)
{
    scene s = bar(10, 2, SFEM_CELL_5_TETS, SFEM_LINEAR);
    const sfem_real from[9] = {0.42, -1, -1, 0.42, 2, -1, 0.42, 0, -0.5}, to[9] = {0.42, -1, -1, 0.42, 2, -1, 0.42, 0, 2};
    sfem_damage_def damage = sfem_default_damage_def();
    sfem_body_def def = sfem_default_body_def();
    sfem_body *b;
    sfem_error err;
    double whole;
    (void)state;
    damage.toughness = 1e12;
    def.refactorise = 0.01;
    b = hang(&s, def, &damage);
    assert_ok(sfem_body_prepare(b, H, &err), err);
    whole = sfemi_slice_total(b->refactor.ldl[0]);
    assert_ok(sfem_body_cut(b, from, to, NULL, &err), err);
    while (!sfem_body_get_refactorisation(b).running) assert_ok(sfem_body_step(b, H, &err), err);
    assert_true(sfem_body_get_refactorisation(b).flops < whole);
    assert_ok(sfem_body_step(b, H, &err), err);
    assert_ok(sfem_body_refactorise(b, NULL, &err), err); /* interrupts it */
    assert_true(sfem_body_get_refactorisation(b).flops >= whole);
    b->refactor.budget = 1e9;
    await_factor(b);
    check_factor(b);
    assert_ok(sfem_body_refactorise(b, &s.model->stiffness, &err), err);
    await_factor(b);
    assert_ok(sfem_body_refactorise(b, NULL, &err), err);
    assert_true(sfem_body_get_refactorisation(b).flops >= whole);
    await_factor(b);
    check_factor(b);
    sfem_body_free(b);
    close_scene(&s);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(what_is_not_looked_at_changes_no_bit),
        cmocka_unit_test(far_from_breaking_nothing_is_looked_at),
        cmocka_unit_test(a_tet_below_its_limit_is_below_its_threshold),
        cmocka_unit_test(a_crack_near_the_root_costs_a_fifth_of_a_factor),
        cmocka_unit_test(a_factor_that_cannot_be_mended_is_made_whole),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
