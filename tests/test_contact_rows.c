/* Rows of contact from inside: what an impulse does to modal bodies, against differences of whole steps; rows over two
 * bodies, against a dense Schur complement. */
#define SFEM_STATIC
#define SOFTFEM_IMPLEMENTATION
#define SFEM_MINIMAL
#define SFEM_ENABLE_CONTACT
#define SFEM_ENABLE_MODES
#define SFEM_ENABLE_REDUCED
#include "support.h"

#include "linear.h"

/* --------------------------------------------------------------------------------------------
 * modal bodies
 * -------------------------------------------------------------------------------------------- */

typedef struct scene {
    sfem_mesh mesh;
    sfem_model *model;
    sfem_modes modes;
    sfem_reduced *reduced;
    sfem_modal *body;
    sfem_contact *contact;
    sfem_int nodes[3];
} scene;

/* A bar that is bent, moves and turns. */
static scene bent(int pinned, sfem_modal_integrator integrator, sfem_warp warp)
{
    const sfem_int cells[3] = {6, 2, 2};
    const sfem_real size[3] = {0.6, 0.1, 0.1};
    sfem_model_def model_def = linear_model_def();
    sfem_modes_def modes_def = sfem_default_modes_def();
    sfem_reduced_def def = sfem_default_reduced_def();
    sfem_modal_def modal_def = sfem_default_modal_def();
    sfem_int pins[9] = {0, 1, 2, 3, 4, 5, 6, 7, 8}, k;
    sfem_real q[12], v[12];
    sfem_error err;
    test_random random = {7};
    scene s;
    memset(&s, 0, sizeof s);
    assert_ok(sfem_mesh_block(cells, size, SFEM_CELL_6_TETS, NULL, &s.mesh, &err), err);
    model_def.mesh = &s.mesh;
    model_def.material.young = 3e5;
    assert_ok(sfem_model_create(&model_def, &s.model, &err), err);
    modes_def.pins = pins;
    modes_def.pin_count = pinned ? 9 : 0;
    modes_def.modes = 12;
    def.stiffness_damping = 2e-3;
    assert_ok(sfem_modes_create(s.model, &modes_def, &s.modes, &err), err);
    assert_ok(sfem_reduced_create(s.model, &s.modes, &def, &s.reduced, &err), err);
    modal_def.integrator = integrator;
    modal_def.warp = warp;
    modal_def.gravity[2] = -9.81;
    assert_ok(sfem_modal_create(s.reduced, &modal_def, &s.body, &err), err);
    assert_ok(sfem_contact_create(NULL, &s.contact, &err), err);
    assert_ok(sfem_contact_add_modal(s.contact, s.body, NULL, 0, NULL, NULL, &err), err);
    for (k = 0; k < 12; ++k) {
        q[k] = 0.3 * random_uniform(&random, -1, 1) / (k + 1);
        v[k] = random_uniform(&random, -1, 1);
    }
    assert_ok(sfem_modal_set_coordinates(s.body, q, v, NULL, &err), err);
    if (!pinned) {
        sfem_rigid rigid = sfem_modal_rigid(s.body);
        for (k = 0; k < 3; ++k) {
            rigid.v[k] = random_uniform(&random, -1, 1);
            rigid.w[k] = random_uniform(&random, -2, 2);
        }
        assert_ok(sfem_modal_set_rigid(s.body, &rigid, &err), err);
    }
    s.nodes[0] = s.mesh.nodes - 1;
    s.nodes[1] = s.mesh.nodes - 9;
    s.nodes[2] = 30;
    return s;
}

static void drop(scene *s)
{
    sfem_contact_free(s->contact);
    sfem_modal_free(s->body);
    sfem_reduced_free(s->reduced);
    sfem_modes_free(&s->modes);
    sfem_model_free(s->model);
    sfem_mesh_free(&s->mesh);
}

/* Rows at the scene's nodes, each with its own axes, as a floor would make them: the last one between all three. */
static void add_rows(scene *s)
{
    sfemi_touch *t = s->contact->touch;
    sfem_obstacle_def floor = sfem_default_obstacle_def();
    sfem_error err;
    sfem_int i;
    int k;
    floor.position[2] = -5;
    assert_ok(sfem_contact_add_obstacle(s->contact, &floor, NULL, &err), err);
    for (i = 0; i < 4; ++i) {
        sfemi_row row;
        memset(&row, 0, sizeof row);
        row.feature = i < 3 ? s->nodes[i] : s->mesh.nodes;
        row.parts = i < 3 ? 1 : 3;
        for (k = 0; k < row.parts; ++k) {
            row.node[k] = s->nodes[i < 3 ? i : k];
            row.weight[k] = i < 3 ? 1 : k == 0 ? 0.5 : 0.25;
        }
        row.local_normal[2] = 1;
        row.axes[2] = row.axes[3] = row.axes[7] = 1;
        assert_ok(sfemi_contact_append(s->contact, t, &row, &err), err);
    }
}

/* J of the warped node against differences of its place. */
static void rows_are_how_places_follow_coordinates(void **unused)
{
    int pinned, warp;
    (void)unused;
    for (pinned = 0; pinned < 2; ++pinned)
        for (warp = SFEM_WARP_NONE; warp <= SFEM_WARP_PATH; ++warp) {
            scene s = bent(pinned, SFEM_MODAL_FITTED, (sfem_warp)warp);
            sfemi_impact *m = sfemi_impact_part(s.contact->touch);
            const size_t stride = s.body->stride;
            sfem_real *rows = (sfem_real *)malloc(3 * stride * sizeof *rows);
            int k, c;
            sfemi_impact_set_out(m);
            sfemi_impact_rows(m, s.nodes[0], rows);
            for (k = 0; k < 12; ++k) {
                const double d = 1e-6, q = s.body->q[k];
                sfem_real x[2][3];
                s.body->q[k] = q + d;
                sfem_modal_node(s.body, s.nodes[0], x[0], NULL, NULL);
                s.body->q[k] = q - d;
                sfem_modal_node(s.body, s.nodes[0], x[1], NULL, NULL);
                s.body->q[k] = q;
                for (c = 0; c < 3; ++c) assert_near(rows[(size_t)c * stride + (size_t)k], (x[0][c] - x[1][c]) / (2 * d), 0, 1e-7);
            }
            free(rows);
            drop(&s);
        }
}

/* The matrix of the forces: dx'/dl of whole steps with a little more impulse in one row. Without warping and rotation it is
 * exact; else it is that of the start, which short steps show. */
static void the_matrix_of_forces_is_what_steps_do(void **unused)
{
    static const sfem_modal_integrator integrator[] = {SFEM_MODAL_NEWMARK, SFEM_MODAL_EXACT, SFEM_MODAL_FITTED};
    int pinned, i, j, c, a, b;
    (void)unused;
    for (i = 0; i < 3; ++i)
        for (pinned = 0; pinned < 2; ++pinned) {
            const double h = pinned ? 1.0 / 60 : 1.0 / 6000;
            scene s = bent(pinned, integrator[i], pinned ? SFEM_WARP_NONE : SFEM_WARP_PATH);
            sfemi_touch *t = s.contact->touch;
            sfemi_impact *m = sfemi_impact_part(t);
            double x[2][3], largest = 0, worst = 0;
            sfem_error err;
            add_rows(&s);
            s.contact->step = 1;
            sfemi_modal_refit(s.body, h);
            sfemi_impact_coefficients(m, h);
            sfem_modal_positions(s.body, m->view, t->x0);
            sfemi_impact_set_out(m);
            memcpy(t->x1, t->x0, 3 * (size_t)t->nodes * sizeof *t->x1);
            assert_ok(sfemi_impact_press(s.contact, t, SFEMI_IMPACT_FORCE, h, &err), err);
            for (j = 0; j < 4; ++j) {
                sfemi_row *row = t->row + j;
                double g[9];
                memset(g, 0, sizeof g);
                for (a = 0; a < row->parts; ++a) /* in space: the rows' d has their own softness */
                    for (b = 0; b < row->parts; ++b)
                        for (c = 0; c < 9; ++c) {
                            const size_t stride = sfemi_contact_stride(s.contact->node[row->at[a]].count);
                            g[c] += row->weight[a] * row->weight[b] *
                                    s.contact->node[row->at[a]].g[(size_t)(c % 3) * stride + 3 * (size_t)row->at[b] + (size_t)(c / 3)];
                        }
                for (c = 0; c < 3; ++c) {
                    const double d = pinned ? 0.01 : 1e-4;
                    int side;
                    for (side = 0; side < 2; ++side) {
                        for (a = 0; a < 4; ++a) memset(t->row[a].impulse, 0, sizeof row->impulse);
                        row->impulse[c] = side ? d : -d;
                        assert_ok(sfemi_impact_run(t, h, &err), err);
                        sfemi_contact_point_of(t, row, t->x1, h, x[side]);
                    }
                    for (a = 0; a < 3; ++a) {
                        const double want = (x[1][a] - x[0][a]) / (2 * d * h);
                        largest = fmax(largest, fabs(want));
                        worst = fmax(worst, fabs(want - g[3 * a + c]));
                    }
                }
            }
            assert_true(worst < (pinned ? 1e-6 : 0.01) * largest);
            drop(&s);
        }
}

/* The matrix of impacts: what an impulse at the start does to the velocities that impacts see; and its work is the energy. */
static void the_matrix_of_impacts_is_what_impulses_do(void **unused)
{
    const double h = 1.0 / 60;
    int pinned, j, c, a;
    (void)unused;
    for (pinned = 0; pinned < 2; ++pinned) {
        scene s = bent(pinned, SFEM_MODAL_NEWMARK, SFEM_WARP_PATH);
        sfemi_touch *t = s.contact->touch;
        sfemi_impact *m = sfemi_impact_part(t);
        sfem_real kinetic;
        sfem_error err;
        add_rows(&s);
        s.contact->step = 1;
        sfemi_modal_refit(s.body, h);
        sfemi_impact_coefficients(m, h);
        sfem_modal_positions(s.body, m->view, t->x0);
        for (j = 0; j < 3; ++j)
            for (c = 0; c < 3; ++c) {
                const double before = sfemi_impact_energy(m, &kinetic);
                double v[2][3], work = m->work, g;
                sfem_int i;
                sfemi_impact_set_out(m);
                assert_ok(sfemi_impact_press(s.contact, t, SFEMI_IMPACT_STRIKE, h, &err), err);
                for (a = 0; a < 4; ++a) memset(t->row[a].change, 0, sizeof t->row[a].change);
                t->row[j].change[c] = 0.05;
                sfemi_impact_velocity(m, t->row[j].at[0], v[0]);
                for (i = 0; i < s.contact->nodes; ++i) /* as if the sweeps had found it */
                    for (a = 0; a < 3; ++a) {
                        const size_t stride = sfemi_contact_stride(s.contact->node[t->row[j].at[0]].count);
                        g = s.contact->node[t->row[j].at[0]].g[(size_t)c * stride + 3 * (size_t)i + (size_t)a];
                        s.contact->v[3 * i + a] = s.contact->v0[3 * i + a] + 0.05 * g;
                    }
                sfemi_impact_take_strikes(s.contact, t);
                sfemi_impact_velocity(m, t->row[j].at[0], v[1]);
                for (a = 0; a < 3; ++a)
                    assert_near(v[1][a], s.contact->v[3 * t->row[j].at[0] + a], 1e-6, 1e-6 * fabs(v[1][a] - v[0][a]));
                assert_near(m->work - work, sfemi_impact_energy(m, &kinetic) - before, 1e-6, 1e-6 * fabs(kinetic));
            }
        drop(&s);
    }
}

/* --------------------------------------------------------------------------------------------
 * rows over two bodies
 * -------------------------------------------------------------------------------------------- */

enum { SIDE = 2, NODES = 27, N = 3 * NODES };

typedef struct pair {
    sfem_mesh mesh;
    sfem_model *model[2];
    sfem_body *body[2];
    sfem_contact *contact;
} pair;

/* Two cubes, one above the other, of different stiffness and weight, the upper one falls on the lower one. */
static pair two_cubes(sfem_law law)
{
    const sfem_int cells[3] = {SIDE, SIDE, SIDE};
    const sfem_real size[3] = {0.2, 0.2, 0.2};
    sfem_real v[N], u[N];
    sfem_error err;
    pair p;
    int k, i;
    memset(&p, 0, sizeof p);
    assert_ok(sfem_mesh_block(cells, size, SFEM_CELL_5_TETS, NULL, &p.mesh, &err), err);
    assert_int_equal(p.mesh.nodes, NODES);
    assert_ok(sfem_contact_create(NULL, &p.contact, &err), err);
    for (k = 0; k < 2; ++k) {
        sfem_model_def model_def = sfem_default_model_def();
        sfem_body_def def = sfem_default_body_def();
        def.p = 0.25;
        model_def.mesh = &p.mesh;
        model_def.material.law = law;
        model_def.material.young = k ? 1e6 : 2e5;
        model_def.material.density = k ? 3000 : 1000;
        assert_ok(sfem_model_create(&model_def, &p.model[k], &err), err);
        assert_ok(sfem_body_create(p.model[k], &def, &p.body[k], &err), err);
        for (i = 0; i < NODES; ++i) {
            const sfem_real at[3] = {k ? 0.03 : 0, k ? 0.02 : 0, k ? 0.201 : 0}, to[3] = {k ? 0.1 : 0, k ? -0.2 : 0.3, k ? -1 : 0.2};
            memcpy(u + 3 * i, at, sizeof at);
            memcpy(v + 3 * i, to, sizeof to);
        }
        assert_ok(sfem_body_set_state(p.body[k], u, v, &err), err);
        assert_ok(sfem_contact_add_body(p.contact, p.body[k], NULL, ~0u, NULL, &err), err);
    }
    return p;
}

static void free_pair(pair *p)
{
    int k;
    sfem_contact_free(p->contact);
    for (k = 0; k < 2; ++k) {
        sfem_body_free(p->body[k]);
        sfem_model_free(p->model[k]);
    }
    sfem_mesh_free(&p->mesh);
}

/* x = A^-1 b, A = M + h^2/4 K by products with unit vectors, by elimination. */
static void dense_solve(const sfem_model *model, double h, double *b)
{
    static double a[N][N];
    sfem_real e[N], kx[N], mx[N];
    int i, j, k;
    for (j = 0; j < N; ++j) {
        memset(e, 0, sizeof e);
        e[j] = 1;
        sfem_model_multiply_stiffness(model, e, kx, NULL);
        sfem_model_multiply_mass(model, e, mx, NULL);
        for (i = 0; i < N; ++i) a[i][j] = mx[i] + h * h / 4 * kx[i];
    }
    for (k = 0; k < N; ++k)
        for (i = k + 1; i < N; ++i) {
            const double f = a[i][k] / a[k][k];
            for (j = k; j < N; ++j) a[i][j] -= f * a[k][j];
            b[i] -= f * b[k];
        }
    for (k = N - 1; k >= 0; --k) {
        for (j = k + 1; j < N; ++j) b[k] -= a[k][j] * b[j];
        b[k] /= a[k][k];
    }
}

/* J A^-1 J^T of a row with a point of each body: of nodes a[3] with weights, minus b[3]. */
static void dense_schur(const pair *p, const sfem_int node[2][3], const double weight[2][3], double h, double w[9])
{
    int k, c, i, a;
    memset(w, 0, 9 * sizeof *w);
    for (k = 0; k < 2; ++k)
        for (c = 0; c < 3; ++c) {
            double x[N];
            memset(x, 0, sizeof x);
            for (i = 0; i < 3; ++i) x[3 * node[k][i] + c] += weight[k][i];
            dense_solve(p->model[k], h, x);
            for (i = 0; i < 3; ++i)
                for (a = 0; a < 3; ++a) w[3 * a + c] += weight[k][i] * x[3 * node[k][i] + a];
        }
}

static void solve3(const double a[9], const double b[3], double x[3])
{
    const double det = a[0] * (a[4] * a[8] - a[5] * a[7]) - a[1] * (a[3] * a[8] - a[5] * a[6]) + a[2] * (a[3] * a[7] - a[4] * a[6]);
    int c, k;
    for (c = 0; c < 3; ++c) {
        double m[9];
        memcpy(m, a, sizeof m);
        for (k = 0; k < 3; ++k) m[3 * k + c] = b[k];
        x[c] = (m[0] * (m[4] * m[8] - m[5] * m[7]) - m[1] * (m[3] * m[8] - m[5] * m[6]) + m[2] * (m[3] * m[7] - m[4] * m[6])) / det;
    }
}

static void momentum(const pair *p, sfem_real before[2][N], double h, double linear[3])
{
    int k, c;
    sfem_int i;
    memset(linear, 0, 3 * sizeof *linear);
    for (k = 0; k < 2; ++k)
        for (i = 0; i < NODES; ++i)
            for (c = 0; c < 3; ++c)
                linear[c] += sfem_model_node_mass(p->model[k])[i] *
                             (sfem_body_displacement(p->body[k])[3 * i + c] - before[k][3 * i + c]) / h;
}

/* Inside: a row between a node of the lower cube and a face of the upper one, which sticks. Its impulse is that of the dense
 * system, the relative velocity at the end closes the gap, and both bodies together keep their momentum. */
static void a_row_over_two_bodies_is_the_dense_system(void **unused)
{
    const double h = 1.0 / 60, weight[2][3] = {{1, 0, 0}, {0.5, 0.2, 0.3}};
    sfem_int node[2][3] = {{0, 0, 0}, {0, 0, 0}}, found = 0, i;
    pair p = two_cubes(SFEM_LINEAR), alone = two_cubes(SFEM_LINEAR);
    sfem_real before[2][N];
    double gap[3] = {0, 0, 0}, apart[3] = {0, 0, 0}, want[3], w[9], l[3], sum[2][3];
    sfemi_row row, *now;
    sfem_error err;
    int k, c;
    (void)unused;
    for (i = 0; i < NODES; ++i) {
        const sfem_real *x = p.mesh.x + 3 * i;
        if (x[2] > 0.19 && x[0] > 0.05 && x[0] < 0.15 && x[1] > 0.05 && x[1] < 0.15) node[0][0] = node[0][1] = node[0][2] = i;
        if (x[2] < 0.01 && (x[0] < 0.05 || x[1] < 0.05) && found < 3) node[1][found++] = i;
    }
    assert_int_equal(found, 3);
    for (k = 0; k < 2; ++k) {
        memcpy(before[k], sfem_body_displacement(p.body[k]), sizeof before[k]);
        assert_ok(sfem_body_step(alone.body[k], h, &err), err);
        for (i = 0; i < 3; ++i)
            for (c = 0; c < 3; ++c) {
                const double sign = k ? -1 : 1, at = p.mesh.x[3 * node[k][i] + c];
                gap[c] += sign * weight[k][i] * (at + before[k][3 * node[k][i] + c]);
                apart[c] += sign * weight[k][i] * (at + sfem_body_displacement(alone.body[k])[3 * node[k][i] + c]);
            }
    }
    momentum(&alone, before, h, sum[0]);
    dense_schur(&p, (const sfem_int(*)[3])node, weight, h, w);
    /* the lower one's point is to be where the upper one's is along z, and not to slide: x, y as before */
    for (c = 0; c < 2; ++c) want[c] = -(apart[c] - gap[c]) / h;
    want[2] = -apart[2] / h;
    solve3(w, want, l);
    assert_true(l[2] < 0 && hypot(l[0], l[1]) < -2 * l[2]); /* it presses the lower one down, and sticks */
    memset(&row, 0, sizeof row);
    row.obstacle = -1;
    row.parts = 4;
    for (k = 0; k < 4; ++k) {
        row.body[k] = k > 0;
        row.node[k] = k ? node[1][k - 1] : node[0][0];
        row.weight[k] = k ? -weight[1][k - 1] : 1;
    }
    row.axes[2] = -1; /* n, from the upper to the lower one */
    row.axes[3] = row.axes[7] = 1;
    row.axes[7] = -1;
    row.friction = 2;
    row.fresh = 1;
    assert_ok(sfemi_contact_append(p.contact, p.contact->touch, &row, &err), err);
    p.contact->shared = 1;
    p.contact->def.tolerance = 1e-10;
    p.contact->def.sweeps = 300;
    assert_ok(sfem_contact_step(p.contact, h, &err), err);
    assert_int_equal(p.contact->touch[0].rows, 1);
    now = p.contact->touch[0].row;
    assert_all_near(now->impulse, l, 3, 1e-6, 0);
    assert_near(now->gap, 0, 0, 1e-9);
    momentum(&p, before, h, sum[1]);
    for (c = 0; c < 3; ++c) assert_near(sum[0][c], sum[1][c], 1e-12, 1e-12);
    assert_true(p.contact->info.work < 0); /* of both together */
    free_pair(&p);
    free_pair(&alone);
}

/* Outside: two bodies' nodes held together by impulses of the caller, by the public functions alone. Linear bodies need one
 * round, and have the dense impulse; those that rotate a few. */
static void impulses_of_the_caller_hold_two_bodies_together(void **unused)
{
    const double h = 1.0 / 60, one[2][3] = {{1, 0, 0}, {1, 0, 0}};
    int law;
    (void)unused;
    for (law = 0; law < 2; ++law) {
        pair p = two_cubes(law ? SFEM_COROTATIONAL : SFEM_LINEAR);
        sfem_int node[2][3] = {{0, 0, 0}, {0, 0, 0}};
        sfem_real before[2][N], column[9 * NODES];
        double c0[2][9], w[9], dense[9], first[3] = {0, 0, 0}, sum[2][3], v[2][3], l[3];
        sfem_error err;
        int k, round, a;
        sfem_contact_remove_body(p.contact, 0);
        sfem_contact_remove_body(p.contact, 1);
        node[0][0] = NODES - 1;
        memset(sum, 0, sizeof sum);
        for (k = 0; k < 2; ++k) {
            memcpy(before[k], sfem_body_displacement(p.body[k]), sizeof before[k]);
            for (a = 0; a < 3; ++a) sum[0][a] += sfem_model_total_mass(p.model[k]) * (k ? (a == 0 ? 0.1 : a == 1 ? -0.2 : -1) : (a == 0 ? 0 : a == 1 ? 0.3 : 0.2));
            assert_ok(sfem_body_prepare(p.body[k], h, &err), err);
            assert_ok(sfem_body_compliance(p.body[k], node[k][0], column, &err), err);
            memcpy(c0[k], column + 9 * node[k][0], sizeof c0[k]);
            assert_ok(sfem_body_predict(p.body[k], h, &err), err);
            assert_ok(sfem_body_solve(p.body[k], &err), err);
        }
        for (a = 0; a < 9; ++a) w[a] = c0[0][a] + c0[1][a];
        dense_schur(&p, (const sfem_int(*)[3])node, one, h, dense);
        if (!law) assert_all_near(w, dense, 9, 1e-9, 0);
        for (round = 0; round < (law ? 12 : 2); ++round) {
            double back[3];
            for (k = 0; k < 2; ++k) sfem_body_free_velocity(p.body[k], node[k][0], v[k]);
            for (a = 0; a < 3; ++a) back[a] = v[1][a] - v[0][a];
            solve3(w, back, l);
            for (a = 0; a < 3; ++a) first[a] += round == 0 ? l[a] : 0;
            for (k = 0; k < 2; ++k) {
                const sfem_real j[3] = {k ? -l[0] : l[0], k ? -l[1] : l[1], k ? -l[2] : l[2]};
                assert_ok(sfem_body_add_impulse(p.body[k], node[k][0], j, &err), err);
                assert_ok(sfem_body_apply_impulses(p.body[k], &err), err);
            }
        }
        assert_true(fabs(first[2]) > 0.01);
        for (k = 0; k < 2; ++k) sfem_body_free_velocity(p.body[k], node[k][0], v[k]);
        assert_all_near(v[0], v[1], 3, law ? 1e-6 : 1e-9, 0);
        for (k = 0; k < 2; ++k) assert_ok(sfem_body_finish(p.body[k], &err), err);
        momentum(&p, before, h, sum[1]);
        for (a = 0; a < 3; ++a) assert_near(sum[0][a], sum[1][a], 1e-11, 1e-11);
        free_pair(&p);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(rows_are_how_places_follow_coordinates),
        cmocka_unit_test(the_matrix_of_forces_is_what_steps_do),
        cmocka_unit_test(the_matrix_of_impacts_is_what_impulses_do),
        cmocka_unit_test(a_row_over_two_bodies_is_the_dense_system),
        cmocka_unit_test(impulses_of_the_caller_hold_two_bodies_together),
    };
    return run_all_tests(tests);
}
