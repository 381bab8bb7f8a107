/* gallery - the pictures of examples/gallery/, of bodies that are
 *
 *     first   pulled by its arms until one tears off, a toy bear on the ground
 *     cut     the tets of that bear, in front of a plane left out
 *     twist   twisted by a turn: stress
 *     plate   struck through by a hammer
 *     hand    bent by a hand and let go: modes, warped; the arrow is the force that the hand feels
 *
 *     gallery [first|cut|twist|plate|hand] [--out DIR] [--quick]
 *     cc -O2 -c -DSOFTFEM_IMPLEMENTATION -x c softfem.h && cc -O2 -I. examples/gallery.c softfem.o -lm
 *
 * Prints `wrote FILE` for each.
 */
#include "support.h"
#include "softfem.h"
#include "elastic.h"

static const ex_option table[] = {
    {"PICTURE", "all|first|cut|twist|plate|hand", "all", "which"},
    {"--out", "DIR", "build/gallery", "where files go"},
    {"--quick", NULL, NULL, "a small run: coarse bodies, few steps"},
    {NULL, NULL, NULL, NULL}};

static const double outside[3] = {0.50, 0.62, 0.74}, inside[3] = {0.96, 0.62, 0.34};
static const double gummy[3] = {0.82, 0.27, 0.25}, torn[3] = {1.0, 0.78, 0.45};

static void must(sfem_status status, const sfem_error *err)
{
    if (status != SFEM_OK) ex_fail("%s", err->text);
}

/* A picture without a caption, softer than the contact sheets of the other examples. */
static ex_picture *begin(int width, int height, const double *lower, const double *upper, const double *from)
{
    ex_picture *p = ex_picture_new(width, height);
    static const double sky[3] = {0.93, 0.95, 0.97}, floor[3] = {0.74, 0.79, 0.85};
    memcpy(p->sky, sky, sizeof sky);
    memcpy(p->sky + 3, floor, sizeof floor);
    ex_view_begin(p, 0, 1, 1, lower, upper, from);
    return p;
}

static void end(ex_picture *p, const char *out, const char *name)
{
    ex_view_end(p, NULL);
    ex_picture_write_small(p, ex_path(out, name));
    printf("wrote %s\n", ex_path(out, name));
    ex_picture_free(p);
}

/* --------------------------------------------------------------------------------------------
 * The bear: spheres, ellipsoids and capsules, blended; it stands on z = 0 and looks along -y. 1 m high.
 * -------------------------------------------------------------------------------------------- */

static double blend(double a, double b, double width) /* smooth minimum */
{
    const double t = ex_clamp(0.5 + 0.5 * (b - a) / width, 0, 1);
    return b + t * (a - b) - width * t * (1 - t);
}

static double ellipsoid(const double *x, double cx, double cy, double cz, double rx, double ry, double rz)
{
    const double a = (x[0] - cx) / rx, b = (x[1] - cy) / ry, c = (x[2] - cz) / rz;
    const double k0 = sqrt(a * a + b * b + c * c);
    const double k1 = sqrt(a * a / (rx * rx) + b * b / (ry * ry) + c * c / (rz * rz));
    return k1 > 0 ? k0 * (k0 - 1) / k1 : -rx;
}

static double capsule(const double *x, const double *a, const double *b, double radius)
{
    double d[3], p[3], t = 0, q;
    int k;
    for (k = 0; k < 3; ++k) d[k] = b[k] - a[k], p[k] = x[k] - a[k];
    t = ex_clamp(ex_dot(p, d) / ex_dot(d, d), 0, 1);
    for (q = 0, k = 0; k < 3; ++k) q += (p[k] - t * d[k]) * (p[k] - t * d[k]);
    return sqrt(q) - radius;
}

static sfem_real bear(const sfem_real x[3], void *user)
{
    static const double shoulder[3] = {0.16, -0.02, 0.53}, hand[3] = {0.41, -0.05, 0.53};
    static const double hip[3] = {0.11, 0, 0.17}, foot[3] = {0.15, -0.15, 0.075};
    const double y[3] = {fabs(x[0]), x[1], x[2]}; /* both sides */
    double d = ellipsoid(y, 0, 0, 0.39, 0.215, 0.17, 0.27);
    (void)user;
    d = blend(d, ellipsoid(y, 0, -0.02, 0.77, 0.185, 0.17, 0.17), 0.05);
    d = blend(d, ellipsoid(y, 0.135, 0, 0.915, 0.075, 0.055, 0.075), 0.03);
    d = blend(d, ellipsoid(y, 0, -0.18, 0.73, 0.085, 0.065, 0.065), 0.03);
    d = blend(d, capsule(y, shoulder, hand, 0.078), 0.05);
    d = blend(d, capsule(y, hip, foot, 0.095), 0.05);
    return fmax(d, 0.004 - x[2]); /* flat soles */
}

static void make_bear(sfem_mesh *mesh, int tets)
{
    const sfem_real box[2][3] = {{-0.6, -0.35, 0}, {0.6, 0.3, 1.1}};
    sfem_mesher_def def = sfem_default_mesher_def();
    sfem_error err;
    def.tets = tets;
    must(sfem_mesh_from_sdf(&def, bear, NULL, box, mesh, NULL, &err), &err);
}

/* --------------------------------------------------------------------------------------------
 * what breaks
 * -------------------------------------------------------------------------------------------- */

/* The surface at x, what breaks have made of it in another colour, moved by `by`. */
static void draw_fragments(ex_picture *p, sfem_body *body, const double *by, const double *skin, const double *flesh)
{
    const double *color[2];
    ex_style style = ex_default_style();
    sfem_fragments f;
    sfem_error err;
    int32_t *tri;
    double *x;
    sfem_int i, count;
    int made, c;
    color[0] = skin, color[1] = flesh;
    must(sfem_body_fragments(body, NULL, &f, &err), &err);
    x = (double *)ex_new(3 * (size_t)f.vertices, sizeof *x);
    tri = (int32_t *)ex_new(3 * (size_t)f.triangles, sizeof *tri);
    sfem_body_fragment_positions(body, &f, x);
    for (i = 0; i < 3 * f.vertices; ++i) x[i] += by[i % 3];
    for (made = 0; made < 2; ++made) {
        for (count = 0, i = 0; i < f.triangles; ++i)
            for (c = 0; f.made[i] == made && c < 3; ++c) tri[count++] = f.tri[3 * i + c];
        memcpy(style.color, color[made], sizeof style.color);
        style.edges = 0;
        style.flat = made;
        ex_view_surface(p, f.vertices, x, count / 3, tri, NULL, &style);
    }
    sfem_fragments_free(&f);
    free(tri);
    free(x);
}

/* Eyes and a nose, on the nodes nearest to their places at rest. */
static void draw_face(ex_picture *p, const sfem_mesh *mesh, sfem_body *body, const double *by)
{
    static const double place[3][3] = {{-0.065, -0.19, 0.82}, {0.065, -0.19, 0.82}, {0, -0.26, 0.76}};
    static const double width[3] = {7, 7, 10}, black[3] = {0.10, 0.07, 0.07};
    double *x = (double *)ex_new(3 * (size_t)mesh->nodes, sizeof *x), at[3];
    sfem_int i, nearest;
    int k, c;
    sfem_body_positions(body, x);
    for (k = 0; k < 3; ++k) {
        double best = 1e30;
        for (nearest = 0, i = 0; i < mesh->nodes; ++i) {
            const double *r = mesh->x + 3 * (size_t)i;
            const double d = hypot(hypot(r[0] - place[k][0], r[1] - place[k][1]), r[2] - place[k][2]);
            if (d < best) best = d, nearest = i;
        }
        for (c = 0; c < 3; ++c) at[c] = x[3 * nearest + c] + by[c] + place[k][c] - mesh->x[3 * nearest + c];
        ex_view_line(p, at, at, width[k], black);
    }
    free(x);
}

typedef struct toy {
    sfem_mesh mesh;
    sfem_model *model;
    sfem_body *body;
    sfem_int *hand, hands; /* nodes that are pulled */
    double h, pulled;
} toy;

static void make_toy(toy *b, int quick)
{
    sfem_model_def model_def = sfem_default_model_def();
    sfem_body_def def = sfem_default_body_def();
    sfem_damage_def damage = sfem_default_damage_def();
    sfem_int *pins, i;
    unsigned char *whole;
    sfem_error err;
    int k;
    make_bear(&b->mesh, quick ? 1500 : 9000);
    model_def.mesh = &b->mesh;
    model_def.material.law = SFEM_COROTATIONAL;
    model_def.material.young = 1e5;
    model_def.material.poisson = 0.4;
    model_def.material.mass_damping = 2;
    must(sfem_model_create(&model_def, &b->model, &err), &err);
    pins = (sfem_int *)ex_new((size_t)b->mesh.nodes, sizeof *pins);
    b->hand = (sfem_int *)ex_new((size_t)b->mesh.nodes, sizeof *b->hand);
    for (i = 0; i < b->mesh.nodes; ++i) {
        const double *x = b->mesh.x + 3 * (size_t)i;
        if (x[2] < 0.02 || fabs(x[0]) > 0.42) pins[def.pin_count++] = i;
        if (fabs(x[0]) > 0.42) b->hand[b->hands++] = i;
    }
    whole = (unsigned char *)ex_new((size_t)b->mesh.tets, 1); /* all but the left shoulder */
    for (i = 0; i < b->mesh.tets; ++i) {
        double x = 0;
        for (k = 0; k < 4; ++k) x += 0.25 * b->mesh.x[3 * (size_t)b->mesh.tet[4 * i + k]];
        whole[i] = x < -0.31 || x > -0.2;
    }
    damage.toughness = 3000;
    damage.weibull = 8;
    damage.unbreakable = whole;
    def.damage = &damage;
    def.pins = pins;
    def.gravity[2] = -9.81;
    must(sfem_body_create(b->model, &def, &b->body, &err), &err);
    b->h = quick ? 0.008 : 0.004;
    free(whole);
    free(pins);
}

/* The hands go apart and up, until `far` or until something has come off. */
static void pull(toy *b, double far)
{
    sfem_error err;
    sfem_int i;
    while (b->pulled < far && sfem_body_fracture(b->body).pieces < 2) {
        b->pulled += 0.6 * b->h;
        for (i = 0; i < b->hands; ++i) {
            const double *x = b->mesh.x + 3 * (size_t)b->hand[i];
            double to[3];
            to[0] = x[0] + (x[0] > 0 ? b->pulled : -b->pulled);
            to[1] = x[1];
            to[2] = x[2] + 0.35 * b->pulled;
            must(sfem_body_move_pin(b->body, b->hand[i], to, &err), &err);
        }
        must(sfem_body_step(b->body, b->h, &err), &err);
    }
}

static void first(const char *out, int quick)
{
    const double lower[3] = {-0.42, -0.2, 0.06}, upper[3] = {3.4, 0.1, 0.94}, from[3] = {0.1, -1, 0.17};
    static const double x[3] = {0, 1.27, 2.92}; /* of the three bears */
    double by[3] = {0, 0, 0};
    ex_picture *p = begin(960, 330, lower, upper, from);
    sfem_error err;
    toy b;
    int k, i;
    memset(&b, 0, sizeof b);
    make_toy(&b, quick);
    p->ground = 0;
    for (k = 0; k < 3; ++k) {
        if (k) pull(&b, k == 1 ? 0.22 : 0.8);
        for (i = 0; k == 2 && i < (quick ? 5 : 20); ++i) must(sfem_body_step(b.body, b.h, &err), &err);
        by[0] = x[k];
        draw_fragments(p, b.body, by, gummy, torn);
        draw_face(p, &b.mesh, b.body, by);
    }
    printf("torn when each hand was pulled by %.2f m\n", b.pulled);
    end(p, out, "first.png");
    sfem_body_free(b.body);
    sfem_model_free(b.model);
    sfem_mesh_free(&b.mesh);
    free(b.hand);
}

/* --------------------------------------------------------------------------------------------
 * the tets behind a plane
 * -------------------------------------------------------------------------------------------- */

static void cut(const char *out, int quick)
{
    const double from[3] = {1, -0.75, 0.3};
    double lower[3], upper[3];
    ex_style style = ex_default_style();
    sfem_surface whole, half;
    sfem_mesh mesh, part;
    unsigned char *skin;
    ex_picture *p;
    sfem_error err;
    int32_t *tri[2];
    long count[2] = {0, 0};
    sfem_int t;
    int k, c;
    make_bear(&mesh, quick ? 1500 : 9000);
    ex_bounds(mesh.x, mesh.nodes, 1, lower, upper);
    part = mesh;
    part.tet = (sfem_int *)ex_new(4 * (size_t)mesh.tets, sizeof *part.tet);
    for (part.tets = 0, t = 0; t < mesh.tets; ++t) {
        double x = 0;
        for (k = 0; k < 4; ++k) x += 0.25 * mesh.x[3 * (size_t)mesh.tet[4 * t + k]];
        if (x < 0.02) memcpy(part.tet + 4 * part.tets++, mesh.tet + 4 * t, 4 * sizeof *part.tet);
    }
    must(sfem_mesh_surface(&mesh, NULL, &whole, &err), &err);
    must(sfem_mesh_surface(&part, NULL, &half, &err), &err);
    skin = (unsigned char *)ex_new((size_t)mesh.nodes, 1);
    for (t = 0; t < 3 * whole.triangles; ++t) skin[whole.tri[t]] = 1;
    for (k = 0; k < 2; ++k) tri[k] = (int32_t *)ex_new(3 * (size_t)half.triangles + 1, sizeof **tri);
    for (t = 0; t < half.triangles; ++t) {
        const sfem_int *v = half.tri + 3 * t;
        k = !(skin[v[0]] && skin[v[1]] && skin[v[2]]);
        for (c = 0; c < 3; ++c) tri[k][3 * count[k] + c] = v[c];
        ++count[k];
    }
    upper[0] = 0.1;
    p = begin(480, 480, lower, upper, from);
    p->ground = 0;
    style.flat = 1;
    style.edges = 0.5;
    for (k = 0; k < 2; ++k) {
        memcpy(style.color, k ? torn : gummy, sizeof style.color);
        ex_view_surface(p, mesh.nodes, mesh.x, count[k], tri[k], NULL, &style);
        free(tri[k]);
    }
    end(p, out, "cut.png");
    sfem_surface_free(&whole);
    sfem_surface_free(&half);
    sfem_mesh_free(&mesh);
    free(part.tet);
    free(skin);
}

/* --------------------------------------------------------------------------------------------
 * a bar, 1 x 0.2 x 0.2 m, twisted by half a turn and by one
 * -------------------------------------------------------------------------------------------- */

static void twist(const char *out, int quick)
{
    const sfem_int cells[3] = {quick ? 10 : 40, quick ? 2 : 8, quick ? 2 : 8};
    const sfem_real size[3] = {1, 0.2, 0.2};
    const double lower[3] = {0, 0, -0.62}, upper[3] = {1, 0.2, 0.2}, from[3] = {0.3, -1, 0.25};
    const int steps = quick ? 40 : 240;
    sfem_model_def model_def = sfem_default_model_def();
    sfem_body_def def = sfem_default_body_def();
    ex_picture *p = begin(640, 470, lower, upper, from);
    ex_style style = ex_default_style();
    double *x, *value[3], *at[3], low;
    sfem_surface surface;
    sfem_model *model;
    sfem_body *body;
    sfem_mesh mesh;
    sfem_error err;
    sfem_int *pins, i;
    int k, shot = 0;
    must(sfem_mesh_block(cells, size, SFEM_CELL_5_TETS, NULL, &mesh, &err), &err);
    must(sfem_mesh_surface(&mesh, NULL, &surface, &err), &err);
    model_def.mesh = &mesh;
    model_def.material.law = SFEM_COROTATIONAL;
    model_def.material.young = 3e5;
    model_def.material.mass_damping = 4;
    must(sfem_model_create(&model_def, &model, &err), &err);
    pins = (sfem_int *)ex_new((size_t)mesh.nodes, sizeof *pins);
    for (i = 0; i < mesh.nodes; ++i)
        if (mesh.x[3 * i] < 1e-9 || mesh.x[3 * i] > 1 - 1e-9) pins[def.pin_count++] = i;
    def.pins = pins;
    must(sfem_body_create(model, &def, &body, &err), &err);
    for (k = 0; k <= steps; ++k) {
        const double a = 2 * 3.14159265358979 * k / steps, c = cos(a), s = sin(a);
        for (i = 0; k && i < def.pin_count; ++i) {
            const double *r = mesh.x + 3 * (size_t)pins[i], y = r[1] - 0.1, z = r[2] - 0.1;
            const double to[3] = {r[0], 0.1 + c * y - s * z, 0.1 + s * y + c * z};
            if (r[0] > 0.5) must(sfem_body_move_pin(body, pins[i], to, &err), &err);
        }
        if (k) must(sfem_body_step(body, 1 / 60.0, &err), &err);
        if (k % (steps / 2)) continue;
        x = at[shot] = (double *)ex_new(3 * (size_t)mesh.nodes, sizeof *x);
        sfem_body_positions(body, x);
        value[shot] = ex_node_stress(model, &mesh, x);
        ex_range(value[shot], mesh.nodes, &low, &style.high);
        for (i = 0; i < mesh.nodes; ++i) x[3 * i + 2] -= 0.31 * shot;
        ++shot;
    }
    style.edges = 0.2;
    for (k = 0; k < shot; ++k) {
        ex_view_surface(p, mesh.nodes, at[k], surface.triangles, surface.tri, value[k], &style);
        free(at[k]);
        free(value[k]);
    }
    end(p, out, "twist.png");
    sfem_body_free(body);
    sfem_model_free(model);
    sfem_surface_free(&surface);
    sfem_mesh_free(&mesh);
    free(pins);
}

/* --------------------------------------------------------------------------------------------
 * a plate, 1 x 1 x 0.05 m, held at its edges; handles go down at 4 m/s and let go
 * -------------------------------------------------------------------------------------------- */

static void plate(const char *out, int quick)
{
    const sfem_int cells[3] = {quick ? 10 : 28, quick ? 10 : 28, quick ? 1 : 2};
    const sfem_real size[3] = {1, 1, 0.05};
    const double lower[3] = {0, 0, -0.42}, upper[3] = {1, 1, 0.05}, from[3] = {0.5, -1, 0.62}, by[3] = {0, 0, 0};
    const double h = quick ? 0.001 : 0.0005;
    const int steps = quick ? 60 : 330;
    sfem_model_def model_def = sfem_default_model_def();
    sfem_body_def def = sfem_default_body_def();
    sfem_damage_def damage = sfem_default_damage_def();
    sfem_int *pins, i, handle[64], handles = 0;
    uint64_t state = 4;
    sfem_model *model;
    sfem_body *body;
    ex_picture *p;
    sfem_mesh mesh;
    sfem_error err;
    int k, c;
    must(sfem_mesh_block(cells, size, SFEM_CELL_5_TETS, NULL, &mesh, &err), &err);
    for (i = 0; i < 3 * mesh.nodes; ++i) { /* so that cracks do not follow the cells */
        const double d = 0.004 * ex_clamp(ex_gauss(&state), -1.5, 1.5), s = size[i % 3];
        if (mesh.x[i] > 1e-9 && mesh.x[i] < s - 1e-9) mesh.x[i] += d;
    }
    model_def.mesh = &mesh;
    model_def.material.law = SFEM_COROTATIONAL;
    model_def.material.young = 5e6;
    model_def.material.mass_damping = 0.1;
    must(sfem_model_create(&model_def, &model, &err), &err);
    pins = (sfem_int *)ex_new((size_t)mesh.nodes, sizeof *pins);
    for (i = 0; i < mesh.nodes; ++i)
        for (c = 0; c < 2; ++c)
            if (mesh.x[3 * i + c] < 1e-9 || mesh.x[3 * i + c] > 1 - 1e-9) {
                pins[def.pin_count++] = i;
                break;
            }
    damage.toughness = 22;
    damage.weibull = 6;
    def.damage = &damage;
    def.pins = pins;
    def.max_handles = 64;
    def.gravity[2] = -9.81;
    must(sfem_body_create(model, &def, &body, &err), &err);
    for (i = 0; i < mesh.nodes && handles < 64; ++i) {
        const double *x = mesh.x + 3 * (size_t)i;
        if (x[2] > 0.049 && hypot(x[0] - 0.5, x[1] - 0.45) < (quick ? 0.1 : 0.07))
            must(sfem_body_grab_node(body, i, &handle[handles++], &err), &err);
    }
    for (k = 0; k < steps; ++k) {
        for (i = 0; i < handles; ++i) {
            double x[3];
            sfem_body_handle_position(body, handle[i], x);
            x[2] -= 4 * h;
            must(sfem_body_move_handle(body, handle[i], x, &err), &err);
        }
        must(sfem_body_step(body, h, &err), &err);
        if (4 * (k + 1) * h < 0.12) continue;
        while (handles) sfem_body_release_handle(body, handle[--handles]);
    }
    p = begin(640, 470, lower, upper, from);
    p->ground = -0.42;
    draw_fragments(p, body, by, outside, inside);
    end(p, out, "plate.png");
    sfem_body_free(body);
    sfem_model_free(model);
    sfem_mesh_free(&mesh);
    free(pins);
}

#ifndef SFEM_NO_REDUCED
/* --------------------------------------------------------------------------------------------
 * a modal bar, 2 x 0.2 x 0.2 m, held at one end, and a hand at the other
 * -------------------------------------------------------------------------------------------- */

static void arrow(ex_picture *p, const double *at, const double *force, double scale)
{
    static const double red[3] = {0.80, 0.22, 0.18};
    double tip[3], barb[3];
    int k, side;
    for (k = 0; k < 3; ++k) tip[k] = at[k] + scale * force[k];
    ex_view_line(p, at, tip, 5, red);
    for (side = -1; side <= 1; side += 2) {
        memcpy(barb, tip, sizeof barb);
        barb[0] += 0.045 * side;
        barb[2] -= 0.075;
        ex_view_line(p, tip, barb, 5, red);
    }
    ex_view_line(p, at, at, 11, red);
}

static void hand(const char *out, int quick)
{
    const sfem_int cells[3] = {quick ? 10 : 40, quick ? 2 : 4, quick ? 2 : 4};
    const sfem_real size[3] = {2, 0.2, 0.2};
    const double lower[3] = {0, 0, -0.2}, upper[3] = {2, 1.1, 1.25}, from[3] = {0.3, -1, 0.27};
    static const double behind[3] = {1.0, 0.5, 0};
    static const double lift[3] = {0, 0.45, 0.95};
    static const double color[3][3] = {{0.72, 0.78, 0.84}, {0.55, 0.67, 0.79}, {0.30, 0.50, 0.72}};
    ex_picture *p = begin(640, 470, lower, upper, from);
    sfem_model_def model_def = sfem_default_model_def();
    sfem_modes_def modes_def = sfem_default_modes_def();
    sfem_reduced_def reduced_def = sfem_default_reduced_def();
    sfem_modal_def def = sfem_default_modal_def();
    ex_style style = ex_default_style();
    sfem_reduced_info info;
    sfem_reduced_view *view;
    sfem_reduced *reduced;
    sfem_model *model;
    sfem_modal *body;
    sfem_modes modes;
    sfem_mesh mesh;
    sfem_error err;
    sfem_int *pins, *face, count = 0, handle, i;
    double start[3], at[3], force[3], *ratio, *x;
    int k, shot;
    must(sfem_mesh_block(cells, size, SFEM_CELL_5_TETS, NULL, &mesh, &err), &err);
    model_def.mesh = &mesh;
    must(sfem_model_create(&model_def, &model, &err), &err);
    pins = (sfem_int *)ex_new((size_t)mesh.nodes, sizeof *pins);
    face = (sfem_int *)ex_new((size_t)mesh.nodes, sizeof *face);
    for (i = 0; i < mesh.nodes; ++i) {
        if (mesh.x[3 * i] < 1e-9) pins[modes_def.pin_count++] = i;
        if (mesh.x[3 * i] > 2 - 1e-9) face[count++] = i;
    }
    modes_def.pins = pins;
    modes_def.modes = 20;
    must(sfem_modes_create(model, &modes_def, &modes, &err), &err);
    ratio = (double *)ex_new(20, sizeof *ratio);
    for (k = 0; k < 20; ++k) ratio[k] = 0.3;
    reduced_def.ratio = ratio;
    must(sfem_reduced_create(model, &modes, &reduced_def, &reduced, &err), &err);
    info = sfem_reduced_get_info(reduced);
    def.max_handle_nodes = count;
    must(sfem_modal_create(reduced, &def, &body, &err), &err);
    must(sfem_reduced_view_surface(reduced, SFEM_MIXED, &view, &err), &err);
    must(sfem_modal_grab_region(body, count, face, NULL, &handle, &err), &err);
    sfem_modal_handle_position(body, handle, start);
    x = (double *)ex_new(3 * (size_t)info.surface_nodes, sizeof *x);
    style.edges = 0.2;
    p->ground = -0.2;
    for (shot = 0; shot < 3; ++shot) {
        for (k = 1; k <= 200; ++k) {
            const double from_lift = shot ? lift[shot - 1] : 0;
            const double d = from_lift + (lift[shot] - from_lift) * fmin(1, k / 100.0);
            at[0] = start[0] - 0.6 * d * d / 2;
            at[1] = start[1];
            at[2] = start[2] + d;
            must(sfem_modal_move_handle(body, handle, at, &err), &err);
            must(sfem_modal_step(body, 0.01, &err), &err);
        }
        sfem_modal_positions(body, view, x);
        for (i = 0; i < info.surface_nodes; ++i) x[3 * i + 1] += behind[shot];
        memcpy(style.color, color[shot], sizeof style.color);
        ex_view_surface(p, info.surface_nodes, x, info.surface_triangles, info.surface_tri, NULL, &style);
        sfem_modal_handle_force(body, handle, force);
        at[0] += 0.01, at[1] += behind[shot];
        if (shot) arrow(p, at, force, 0.3 / (shot == 1 ? 70 : 150));
    }
    end(p, out, "hand.png");
    sfem_modal_free(body);
    sfem_reduced_view_free(view);
    sfem_reduced_free(reduced);
    sfem_modes_free(&modes);
    sfem_model_free(model);
    sfem_mesh_free(&mesh);
    free(ratio);
    free(pins);
    free(face);
    free(x);
}

#else
static void hand(const char *out, int quick)
{
    (void)quick;
    printf("left out, SFEM_NO_REDUCED is defined: %s\n", ex_path(out, "hand.png"));
}
#endif

int main(int argc, char **argv)
{
    const ex_options o = ex_parse(argc, argv, "The pictures of examples/gallery/.", table);
    static void (*const draw[5])(const char *, int) = {first, cut, twist, plate, hand};
    const char *out = ex_text(&o, "--out");
    const int chosen = ex_choice(&o, "PICTURE");
    int k;
    ex_make_directory(out);
    for (k = 0; k < 5; ++k)
        if (chosen == 0 || chosen == k + 1) draw[k](out, ex_given(&o, "--quick"));
    return 0;
}
