/* cracks.h - bodies whose cracks are known: a double cantilever beam, an L-shaped panel, Kalthoff and Winkler's plate.
 *
 *     cracks_dcb(kind, arm, &result)       arm: cells over the height of an arm
 *     cracks_panel(kind, n, by, &result)   n: cells over a leg; by: how far nodes are moved, in cells
 *     cracks_panel_griffith(n, a)          its load by Griffith's theory, from compliances of two slits
 *     cracks_impact(kind, n, &result)      n: cells over the plate's height
 *
 * All are one cell thick, with x along and z up. Meshes are those of tests/strip.h.
 */
#ifndef SFEM_BENCH_CRACKS_H
#define SFEM_BENCH_CRACKS_H

#include "../tests/strip.h"

typedef struct cracks {
    sfem_mesh mesh;
    sfem_model *model;
    sfem_body *body;
    sfem_int *pins, pin_count;
    unsigned char *axes, *tough; /* [pin_count], [tets] 1: does not break */
    double *reaction;
    sfem_break *path; /* what broke, but by blades */
    int count, room;
} cracks;

typedef struct cracks_result {
    double load;             /* the largest force, N */
    double start;            /* displacement at which the crack had grown by a cell, m */
    double reach;            /* double cantilever beam: length of the crack at the end, m */
    double expected;         /* and by beam theory */
    double angle;            /* of the crack, degrees */
    double end[2];           /* x, z of its end, m */
    int tets;
} cracks_result;

BODY_STATIC void cracks_begin(cracks *c)
{
    const size_t nodes = (size_t)c->mesh.nodes;
    c->pins = (sfem_int *)body_new(nodes, sizeof *c->pins);
    c->axes = (unsigned char *)body_new(nodes, 1);
    c->tough = (unsigned char *)body_new((size_t)c->mesh.tets, 1);
    c->reaction = (double *)body_new(3 * nodes, sizeof *c->reaction);
}

BODY_STATIC void cracks_pin(cracks *c, sfem_int node, int axes)
{
    c->axes[c->pin_count] = (unsigned char)axes;
    c->pins[c->pin_count++] = node;
}

BODY_STATIC void cracks_make(cracks *c, sfem_material material, double toughness)
{
    sfem_model_def def = sfem_default_model_def();
    sfem_damage_def damage = sfem_default_damage_def();
    sfem_body_def body = sfem_default_body_def();
    sfem_error err;
    def.mesh = &c->mesh;
    def.material = material;
    strip_must(sfem_model_create(&def, &c->model, &err), &err);
    damage.toughness = toughness;
    damage.unbreakable = c->tough;
    body.damage = &damage;
    body.pins = c->pins;
    body.pin_axes = c->axes;
    body.pin_count = c->pin_count;
    strip_must(sfem_body_create(c->model, &body, &c->body, &err), &err);
}

/* A blade across the thickness, from x = -inf to `to` at height z. */
BODY_STATIC void cracks_notch(cracks *c, double z, double to)
{
    const double far = 100 * c->mesh.x[0] + 100;
    double from[9] = {to, -far, 0, to, far, 0, -far, 0, 0}, end[9];
    sfem_error err;
    int k;
    memcpy(end, from, sizeof end);
    for (k = 2; k < 9; k += 3) from[k] = z * (1 - 1e-6), end[k] = z * (1 + 1e-6);
    strip_must(sfem_body_cut(c->body, from, end, NULL, &err), &err);
}

BODY_STATIC void cracks_step(cracks *c, double h)
{
    sfem_int count, k;
    sfem_error err;
    const sfem_break *b;
    strip_must(sfem_body_step(c->body, h, &err), &err);
    b = sfem_body_breaks(c->body, &count);
    for (k = 0; k < count; ++k) {
        if (b[k].reason == SFEM_BROKE_BLADE) continue;
        if (c->count == c->room) {
            c->room = 2 * c->room + 64;
            c->path = (sfem_break *)realloc(c->path, (size_t)c->room * sizeof *c->path);
            if (!c->path) exit(2);
        }
        c->path[c->count++] = b[k];
    }
}

BODY_STATIC void cracks_end(cracks *c, cracks_result *r)
{
    r->tets = (int)c->mesh.tets;
    sfem_body_free(c->body);
    sfem_model_free(c->model);
    sfem_mesh_free(&c->mesh);
    free(c->pins);
    free(c->axes);
    free(c->tough);
    free(c->reaction);
    free(c->path);
}

/* The block of strip_block, so high. */
BODY_STATIC void cracks_block(cracks *c, int kind, int nx, int nz, double height)
{
    const int cells[3] = {nx, 1, nz};
    sfem_error err;
    sfem_int i;
    memset(c, 0, sizeof *c);
    strip_must(strip_block(kind, cells, 3, &c->mesh, &err), &err);
    for (i = 0; i < 3 * c->mesh.nodes; ++i) c->mesh.x[i] *= height;
    cracks_begin(c);
}

/* ---- the double cantilever beam ----
 *
 *      ^ ________________________________
 *     ---------------.                   |   arms of height h = 0.5 m, 5 m long, a crack of a = 2 m, clamped at the end;
 *        ________________________________|   only tets at mid height break: no side grooves are needed
 *      v
 *     G = 12 P^2 (a + chi h)^2/(b^2 E h^3) = 3 E h^3 D^2/(16 (a + chi h)^4), P on each arm, D the opening, and
 *     chi^2 = E/(11 mu) (3 - 2 (g/(1+g))^2), g = 1.18 E/mu: shear and the elastic root [Hashemi, Kinloch, Williams 1990].
 */
#define CRACKS_ARM 0.5

BODY_STATIC double cracks_dcb_root(void)
{
    const double over = 2.6, g = 1.18 * over, part = g / (1 + g); /* E/mu at nu = 0.3 */
    return CRACKS_ARM * sqrt(over / 11 * (3 - 2 * part * part));
}

/* The opening D at which a crack of length a advances, and the force, for E = 10^6 Pa, Gc = 1 J/m^2, a thickness b. */
BODY_STATIC double cracks_dcb_opening(double a)
{
    const double whole = a + cracks_dcb_root();
    return sqrt(16 / (3e6 * CRACKS_ARM * CRACKS_ARM * CRACKS_ARM)) * whole * whole;
}

BODY_STATIC double cracks_dcb_force(double a, double b)
{
    return b * sqrt(1e6 * CRACKS_ARM * CRACKS_ARM * CRACKS_ARM / 12) / (a + cracks_dcb_root());
}

#define CRACKS_DCB_NOTCH 2.0001

BODY_STATIC void cracks_dcb(int kind, int arm, cracks_result *r)
{
    const double h = 2.0 / (2 * arm * sqrt(1000.0)), cell = CRACKS_ARM / arm, seconds = 10;
    const double height = 2 * CRACKS_ARM + cell, z = height / 2 + (kind == STRIP_CENTRED) * cell / 4, most = cracks_dcb_opening(3.2);
    sfem_material m = sfem_default_material();
    sfem_error err;
    sfem_int i;
    cracks c;
    int k;
    memset(r, 0, sizeof *r);
    cracks_block(&c, kind, 10 * arm, 2 * arm + 1, height);
    for (i = 0; i < c.mesh.nodes; ++i) {
        const double *x = c.mesh.x + 3 * (size_t)i;
        if (x[0] < 1e-9 && fabs(x[2] - z) > 0.3 * cell) cracks_pin(&c, i, SFEM_AXIS_Z);
        if (x[0] > 5 - 1e-9) cracks_pin(&c, i, SFEM_AXIS_ALL);
    }
    for (i = 0; i < c.mesh.tets; ++i) {
        int far = 1;
        for (k = 0; k < 4; ++k) far &= fabs(c.mesh.x[3 * (size_t)c.mesh.tet[4 * i + k] + 2] - z) > cell;
        c.tough[i] = (unsigned char)far;
    }
    m.law = SFEM_LINEAR;
    m.mass_damping = 2;
    cracks_make(&c, m, 1);
    cracks_notch(&c, z, CRACKS_DCB_NOTCH);
    for (k = 1; h * k < seconds; ++k) {
        const double t = h * k / seconds, way = most * (t < 0.2 ? t * t * 2.5 : t - 0.1) / 0.9; /* softly at first */
        double force = 0;
        int j;
        for (i = 0; i < c.pin_count; ++i) {
            double to[3];
            if (c.axes[i] == SFEM_AXIS_ALL) continue;
            memcpy(to, c.mesh.x + 3 * (size_t)c.pins[i], sizeof to);
            to[2] += to[2] > z ? way / 2 : -way / 2;
            strip_must(sfem_body_move_pin(c.body, c.pins[i], to, &err), &err);
        }
        cracks_step(&c, h);
        sfem_body_reactions(c.body, c.reaction);
        for (i = 0; i < c.pin_count; ++i)
            if (c.axes[i] != SFEM_AXIS_ALL && c.mesh.x[3 * (size_t)c.pins[i] + 2] > z)
                force += c.reaction[3 * (size_t)c.pins[i] + 2];
        for (j = 0; j < c.count; ++j) r->reach = fmax(r->reach, c.path[j].x[0] + cell / 2);
        if (r->reach > CRACKS_DCB_NOTCH + cell) {
            if (r->start == 0) r->start = way;
        } else if (force > r->load) r->load = force;
        r->expected = pow(3e6 * 0.125 * way * way / 16, 0.25) - cracks_dcb_root();
    }
    cracks_end(&c, r);
}

/* ---- the L-shaped panel of Winkler ----
 *
 *      ____________
 *     |            |   500 x 500 mm, a quarter of it missing, 100 mm thick; E = 25.85 GPa, nu = 0.18, Gc = 90 J/m^2;
 *     |      ______|   held below, the leg pushed up 30 mm from its end. In the test the crack leaves the corner to the
 *     |     |   ^      left, somewhat up, at 8 kN [Winkler 2001]. Concrete is not brittle: its process zone is as long
 *     |_____|          as the panel. So a slit of 62.5 mm is added, to the left of the corner, and the load compared with
 *      #####           Griffith's of the same slit, from compliances.
 */
#define CRACKS_SLIT 0.0625
#define CRACKS_PANEL 0.5
#define CRACKS_PANEL_THICK 0.1

BODY_STATIC sfem_material cracks_concrete(void)
{
    sfem_material m = sfem_default_material();
    m.law = SFEM_LINEAR;
    m.young = 25.85e9;
    m.poisson = 0.18;
    m.density = 2400;
    m.mass_damping = 1500;
    return m;
}

/* The block of 2n x 2n cells without its lower right quarter. With slit > 0, m, nodes left of the corner and as near are
 * double: a slit at the corner's height. by: inner nodes are moved by so many cells. Loses the centres of strip_block. */
BODY_STATIC void cracks_panel_mesh(cracks *c, int kind, int n, double slit, double by)
{
    const double cell = CRACKS_PANEL / (2 * n), half = CRACKS_PANEL / 2;
    const int cells[3] = {2 * n, 1, 2 * n};
    sfem_mesh all;
    sfem_error err;
    sfem_int i, tets = 0, nodes = 0, *tet, *index;
    body_random random;
    double *x;
    int k;
    random.state = 5;
    memset(c, 0, sizeof *c);
    strip_must(strip_block(kind, cells, 3, &all, &err), &err);
    tet = (sfem_int *)body_new(4 * (size_t)all.tets, sizeof *tet);
    index = (sfem_int *)body_new(2 * (size_t)all.nodes, sizeof *index);
    x = (double *)body_new(6 * (size_t)all.nodes, sizeof *x);
    for (i = 0; i < 3 * all.nodes; ++i) all.x[i] *= CRACKS_PANEL;
    for (i = 0; i < 2 * all.nodes; ++i) index[i] = -1;
    for (i = 0; i < all.tets; ++i) {
        const sfem_int *t = all.tet + 4 * (size_t)i;
        double middle[2] = {0, 0};
        for (k = 0; k < 8; ++k) middle[k % 2] += all.x[3 * (size_t)t[k / 2] + 2 * (size_t)(k % 2)] / 4;
        if (middle[0] > half && middle[1] < half) continue;
        for (k = 0; k < 4; ++k) {
            const double *at = all.x + 3 * (size_t)t[k];
            const int twin = slit > 0 && fabs(at[2] - half) < 1e-9 && at[0] > half - slit + 1e-9 && at[0] < half + 1e-9 && middle[1] < half;
            sfem_int *to = index + 2 * (size_t)t[k] + twin;
            if (*to < 0) {
                int axis;
                *to = nodes;
                for (axis = 0; axis < 3; ++axis) {
                    const double step = body_uniform(&random, -by, by) * cell;
                    const int inside = axis != 1 && at[axis] > 1e-9 && at[axis] < CRACKS_PANEL - 1e-9 &&
                                       (at[0] < half - 1e-9 || at[2] > half + 1e-9) && fabs(at[axis] - half) > 1e-9;
                    x[3 * nodes + axis] = at[axis] + (inside ? step : 0);
                }
                ++nodes;
            }
            tet[4 * (size_t)tets + (size_t)k] = *to;
        }
        ++tets;
    }
    strip_must(sfem_mesh_copy(nodes, x, tets, tet, NULL, &c->mesh, &err), &err);
    sfem_mesh_free(&all);
    free(index);
    free(tet);
    free(x);
    cracks_begin(c);
    for (i = 0; i < c->mesh.nodes; ++i) {
        const double *at = c->mesh.x + 3 * (size_t)i;
        if (at[2] < 1e-9) cracks_pin(c, i, SFEM_AXIS_ALL);
        if (fabs(at[2] - half) < 1e-9 && fabs(at[0] - 0.47) < 0.6 * cell) cracks_pin(c, i, SFEM_AXIS_Z);
    }
}

BODY_STATIC void cracks_panel_push(cracks *c, double way)
{
    sfem_error err;
    sfem_int i;
    for (i = 0; i < c->pin_count; ++i) {
        double to[3];
        if (c->axes[i] == SFEM_AXIS_ALL) continue;
        memcpy(to, c->mesh.x + 3 * (size_t)c->pins[i], sizeof to);
        to[2] += way;
        strip_must(sfem_body_move_pin(c->body, c->pins[i], to, &err), &err);
    }
}

/* N, of the whole thickness: the mesh is one cell thick. */
BODY_STATIC double cracks_panel_force(cracks *c, double thick)
{
    double force = 0;
    sfem_int i;
    sfem_body_reactions(c->body, c->reaction);
    for (i = 0; i < c->pin_count; ++i)
        if (c->axes[i] != SFEM_AXIS_ALL) force += c->reaction[3 * (size_t)c->pins[i] + 2];
    return force * CRACKS_PANEL_THICK / thick;
}

/* P of G = P^2/(2 b) dC/da = Gc from the compliances C of slits one cell shorter and longer than a: static solutions. */
BODY_STATIC double cracks_panel_griffith(int n, double a)
{
    double compliance[2];
    int k;
    for (k = 0; k < 2; ++k) {
        sfem_model_def def = sfem_default_model_def();
        sfem_body_def held = sfem_default_body_def();
        sfem_error err;
        cracks c;
        cracks_panel_mesh(&c, STRIP_6_TETS, n, a + (k - 0.5) * CRACKS_PANEL / n, 0);
        def.mesh = &c.mesh;
        def.material = cracks_concrete();
        strip_must(sfem_model_create(&def, &c.model, &err), &err);
        held.pins = c.pins;
        held.pin_axes = c.axes;
        held.pin_count = c.pin_count;
        strip_must(sfem_body_create(c.model, &held, &c.body, &err), &err);
        cracks_panel_push(&c, 1e-4);
        strip_must(sfem_body_solve_static(c.body, &err), &err);
        compliance[k] = 1e-4 / cracks_panel_force(&c, CRACKS_PANEL / (2 * n));
        sfem_body_free(c.body);
        sfem_model_free(c.model);
        sfem_mesh_free(&c.mesh);
        free(c.pins), free(c.axes), free(c.tough), free(c.reaction);
    }
    return sqrt(2 * CRACKS_PANEL_THICK * 90 / ((compliance[1] - compliance[0]) / (CRACKS_PANEL / n)));
}

BODY_STATIC void cracks_panel(int kind, int n, double by, cracks_result *r)
{
    const double cell = CRACKS_PANEL / (2 * n), h = 2 * cell / 3300, seconds = 0.02;
    const double tip = CRACKS_PANEL / 2 - CRACKS_SLIT, z = CRACKS_PANEL / 2 - cell / 2;
    double from[9], to[9];
    sfem_error err;
    cracks c;
    int k, j;
    memset(r, 0, sizeof *r);
    cracks_panel_mesh(&c, kind, n, 0, by);
    for (k = 0; k < c.mesh.tets; ++k) /* not where it is pushed or held */
        for (j = 0; j < 4; ++j) {
            const double *x = c.mesh.x + 3 * (size_t)c.mesh.tet[4 * k + j];
            c.tough[k] |= x[0] > 0.4 || x[2] < 0.05;
        }
    cracks_make(&c, cracks_concrete(), 90);
    for (k = 0; k < 9; ++k) {
        from[k] = k == 6 ? 9 : k % 3 == 0 ? tip + 1e-6 : k == 1 ? -9 : k == 4 ? 9 : k % 3 == 2 ? z - 1e-7 : 0;
        to[k] = from[k] + (k % 3 == 2 ? 2e-7 : 0);
    }
    strip_must(sfem_body_cut(c.body, from, to, NULL, &err), &err);
    r->end[0] = 1;
    for (k = 1; h * k < seconds; ++k) {
        const double way = 0.4e-3 * h * k / seconds;
        double force;
        cracks_panel_push(&c, way);
        j = c.count;
        cracks_step(&c, h);
        force = cracks_panel_force(&c, cell);
        if (r->end[0] > tip - cell && force > r->load) r->load = force;
        for (; j < c.count; ++j)
            if (c.path[j].x[0] < r->end[0]) r->end[0] = c.path[j].x[0], r->end[1] = c.path[j].x[2];
        if (r->start == 0 && c.count > 0) r->start = way;
        if (r->end[0] < 0.06) break;
    }
    r->angle = atan2(r->end[1] - z, tip - r->end[0]) * 180 / 3.14159265358979323846;
    cracks_end(&c, r);
}

/* ---- Kalthoff and Winkler's plate ----
 *
 *         _______________
 *        |               |   100 x 100 mm, the upper half of a plate of steel, with a notch of 50 mm, 25 mm from the plane
 *        |_______        |   of symmetry. What is below the notch is struck at 16.5 m/s from the left: its edge moves at
 *     -> |               |   that speed. The crack leaves the notch at 65 to 70 degrees [Kalthoff 2000]
 *     -> |_______________|   E = 190 GPa, nu = 0.3, 8000 kg/m^3, Gc = 22 130 J/m^2 [Borden et al. 2012]
 *          symmetry
 */
BODY_STATIC void cracks_impact(int kind, int n, cracks_result *r)
{
    const double cell = 0.1 / n, h = cell / 5800 / 2, seconds = 90e-6, tip[2] = {0.05, 0.025 + cell / 2.2};
    sfem_material m = sfem_default_material();
    sfem_error err;
    sfem_int i;
    cracks c;
    int k, j;
    memset(r, 0, sizeof *r);
    cracks_block(&c, kind, n, n, 0.1);
    for (i = 0; i < c.mesh.nodes; ++i) {
        const double *x = c.mesh.x + 3 * (size_t)i;
        const int struck = x[0] < 1e-9 && x[2] < tip[1], plane = x[2] < 1e-9;
        if (struck || plane) cracks_pin(&c, i, (struck ? SFEM_AXIS_X : 0) | (plane ? SFEM_AXIS_Z : 0));
    }
    for (i = 0; i < c.mesh.tets; ++i) /* what the bullet holds */
        for (k = 0; k < 4; ++k) {
            const double *x = c.mesh.x + 3 * (size_t)c.mesh.tet[4 * i + k];
            c.tough[i] |= x[0] < 2.5 * cell && x[2] < tip[1] + cell;
        }
    m.law = SFEM_COROTATIONAL;
    m.young = 190e9;
    m.poisson = 0.3;
    m.density = 8000;
    cracks_make(&c, m, 22130);
    cracks_notch(&c, tip[1], tip[0]);
    for (k = 1; h * k < seconds; ++k) {
        const double t = h * k, way = 16.5 * (t < 1e-6 ? t * t / 2e-6 : t - 0.5e-6);
        for (i = 0; i < c.pin_count; ++i) {
            double to[3];
            if (!(c.axes[i] & SFEM_AXIS_X)) continue;
            memcpy(to, c.mesh.x + 3 * (size_t)c.pins[i], sizeof to);
            to[0] += way;
            strip_must(sfem_body_move_pin(c.body, c.pins[i], to, &err), &err);
        }
        j = c.count;
        cracks_step(&c, h);
        for (; j < c.count; ++j)
            if (c.path[j].x[2] > r->end[1] && c.path[j].x[0] > 0.03) r->end[0] = c.path[j].x[0], r->end[1] = c.path[j].x[2];
        if (r->start == 0 && c.count > 2) r->start = h * k;
        if (r->end[1] > 0.09) break;
    }
    r->angle = atan2(r->end[1] - tip[1], r->end[0] - tip[0]) * 180 / 3.14159265358979323846;
    cracks_end(&c, r);
}

#endif
