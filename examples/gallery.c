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
#include "scenes/all.h"

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

/* A scene with some of its sliders: pairs of a name and a value, then NULL. */
static sc_world *scene(const char *name, ...)
{
    const sc_scene *scene = sc_find(name);
    double value[SC_SLIDERS];
    const char *slider;
    sfem_error err;
    sc_world *w;
    va_list list;
    int k;
    for (k = 0; k < SC_SLIDERS; ++k) value[k] = scene->slider[k].value;
    va_start(list, name);
    while ((slider = va_arg(list, const char *)) != NULL) value[sc_slider_of(scene, slider)] = va_arg(list, double);
    va_end(list);
    w = sc_open(scene, value, &err);
    if (!w) ex_fail("%s: %s", name, err.text);
    return w;
}

static void step(sc_world *w, int steps)
{
    sfem_error err;
    must(sc_run(w, steps, &err), &err);
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

static void first(const char *out, int quick)
{
    const double lower[3] = {-0.42, -0.2, 0.06}, upper[3] = {3.4, 0.1, 0.94}, from[3] = {0.1, -1, 0.17};
    static const double x[3] = {0, 1.27, 2.92}; /* of the three bears */
    double by[3] = {0, 0, 0};
    ex_picture *p = begin(960, 330, lower, upper, from);
    sc_world *w = scene("tear", "tets", quick ? 1500.0 : 9000.0, "h", quick ? 8.0 : 4.0, NULL);
    int k;
    p->ground = 0;
    for (k = 0; k < 3; ++k) {
        while (k == 1 && !w->phase && w->way < 0.22) step(w, 1);
        while (k == 2 && !w->phase && w->way < 0.8) step(w, 1);
        if (k == 2) step(w, quick ? 5 : 20);
        by[0] = x[k];
        draw_fragments(p, w->item[0].body, by, gummy, torn);
        draw_face(p, &w->mesh, w->item[0].body, by);
    }
    printf("torn when each hand was pulled by %.2f m\n", w->way);
    end(p, out, "first.png");
    sc_close(w);
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
    sc_world *w = scene("grab", "tets", quick ? 1500.0 : 9000.0, NULL);
    sfem_mesh mesh = w->mesh, part = w->mesh;
    unsigned char *skin;
    ex_picture *p;
    sfem_error err;
    int32_t *tri[2];
    long count[2] = {0, 0};
    sfem_int t;
    int k, c;
    ex_bounds(mesh.x, mesh.nodes, 1, lower, upper);
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
    sc_close(w);
    free(part.tet);
    free(skin);
}

/* --------------------------------------------------------------------------------------------
 * a bar, 1 x 0.2 x 0.2 m, twisted by half a turn and by one
 * -------------------------------------------------------------------------------------------- */

static void twist(const char *out, int quick)
{
    const double lower[3] = {0, 0, -0.62}, upper[3] = {1, 0.2, 0.2}, from[3] = {0.3, -1, 0.25};
    ex_picture *p = begin(640, 470, lower, upper, from);
    ex_style style = ex_default_style();
    sc_world *w = scene("twist", "tets", quick ? 500.0 : 12000.0, "rate", quick ? 1.0 : 0.25, "damping", 4.0, NULL);
    double *x, *value[3], *at[3], low;
    int k, shot;
    for (shot = 0; shot < 3; ++shot) {
        while (w->way < 0.5 * shot - 1e-9) step(w, 1);
        x = at[shot] = (double *)ex_new(3 * (size_t)w->mesh.nodes, sizeof *x);
        sc_positions(w, 0, x);
        value[shot] = ex_node_stress(w->model, &w->mesh, x);
        ex_range(value[shot], w->mesh.nodes, &low, &style.high);
        for (k = 0; k < w->mesh.nodes; ++k) x[3 * k + 2] -= 0.31 * shot;
    }
    style.edges = 0.2;
    for (k = 0; k < shot; ++k) {
        ex_view_surface(p, w->mesh.nodes, at[k], w->surface.triangles, w->surface.tri, value[k], &style);
        free(at[k]);
        free(value[k]);
    }
    end(p, out, "twist.png");
    sc_close(w);
}

/* --------------------------------------------------------------------------------------------
 * a plate, 1 x 1 x 0.05 m, held at its edges; handles go down at 7 m/s and let go
 * -------------------------------------------------------------------------------------------- */

static void plate(const char *out, int quick)
{
    const double lower[3] = {0, 0, -0.42}, upper[3] = {1, 1, 0.05}, from[3] = {0.5, -1, 0.62}, by[3] = {0, 0, 0};
    ex_picture *p = begin(640, 470, lower, upper, from);
    sc_world *w = scene("shatter", "tets", quick ? 500.0 : 7840.0, "h", quick ? 1.0 : 0.5, "toughness", 60.0, "damping", 0.1,
                        "accuracy", 1e-4, "blow", 7.0, NULL);
    step(w, quick ? 60 : 330);
    p->ground = w->floor;
    draw_fragments(p, w->item[0].body, by, outside, inside);
    end(p, out, "plate.png");
    sc_close(w);
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
