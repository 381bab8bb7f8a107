/* mesh - a mesh or a surface of the user, from memory; made 1 m large, held at one side, or hung up.
 *
 * data of sc_open_with is an sc_file. Without one, the scene has a ball.
 */
#ifndef SFEM_EXAMPLES_SCENES_MESH_H
#define SFEM_EXAMPLES_SCENES_MESH_H

#ifndef SFEM_NO_MESHIO
#include "shapes.h"

typedef struct sc_file {
    const char *name; /* what it ends with tells surfaces from meshes */
    const void *bytes;
    size_t size;
    sfem_surface skin; /* of a surface file, after it was read: 1 m large, to be drawn. Freed by the owner */
} sc_file;

SC_STATIC int sc_ends_with(const char *name, const char *end)
{
    const size_t n = strlen(name), m = strlen(end);
    size_t i;
    if (n < m) return 0;
    for (i = 0; i < m; ++i)
        if ((name[n - m + i] | 32) != (end[i] | 32)) return 0;
    return 1;
}

/* 1 m large, on z = 0, above the origin; up: the axis that points upwards there, 0 to 2. */
SC_STATIC void sc_put_upright(double *x, sfem_int nodes, int up)
{
    double low[3] = {1e300, 1e300, 1e300}, high[3] = {-1e300, -1e300, -1e300}, size = 0;
    sfem_int i;
    int c;
    for (i = 0; i < nodes; ++i) {
        double *p = x + 3 * (size_t)i, y[3];
        for (c = 0; c < 3; ++c) y[c] = p[(up + 1 + c) % 3];
        for (c = 0; c < 3; ++c) p[c] = y[c], low[c] = fmin(low[c], y[c]), high[c] = fmax(high[c], y[c]);
    }
    for (c = 0; c < 3; ++c) size = fmax(size, high[c] - low[c]);
    for (i = 0; size > 0 && i < 3 * nodes; ++i) {
        c = (int)(i % 3);
        x[i] = (x[i] - (c == 2 ? low[c] : 0.5 * (low[c] + high[c]))) / size;
    }
}

SC_STATIC sfem_status sc_read_file(sc_world *w, sc_file *f, sfem_error *err)
{
    const int up = (int)sc_value(w, "up", 2);
    sfem_mesher_def def = sfem_default_mesher_def();
    def.tets = (sfem_int)sc_value(w, "tets", 2500);
    if (!(sc_ends_with(f->name, ".obj") || sc_ends_with(f->name, ".stl") || sc_ends_with(f->name, ".ply") ||
          sc_ends_with(f->name, ".off"))) {
        SC_TRY(sfem_mesh_parse(f->bytes, f->size, NULL, &w->mesh, err));
        SC_TRY(sfem_mesh_remove_unused(&w->mesh, NULL, err));
        sc_put_upright(w->mesh.x, w->mesh.nodes, up);
        return sfem_mesh_check(&w->mesh, NULL, err);
    }
    sfem_surface_free(&f->skin);
    SC_TRY(sfem_surface_parse(f->bytes, f->size, NULL, &f->skin, err));
    sc_put_upright(f->skin.x, f->skin.nodes, up);
    return sfem_mesh_from_surface(&def, &f->skin, &w->mesh, NULL, err);
}

SC_STATIC sfem_status sc_mesh_create(sc_world *w, sfem_error *err)
{
    sfem_damage_def damage = sc_damage_def(w);
    const double part = sc_value(w, "held", 0.04);
    double high = 0;
    sfem_body_def def;
    sfem_int i;
    /* the file is of the one who opens the world, who keeps its skin: the one thing here that is not const */
    if (!sc_same_mesh(w)) {
        if (w->data) SC_TRY(sc_read_file(w, (sc_file *)(uintptr_t)w->data, err));
        else SC_TRY(sfem_mesh_ball(0.5, 5, NULL, &w->mesh, err));
        if (!w->data) sc_put_upright(w->mesh.x, w->mesh.nodes, 2);
    }
    SC_TRY(sc_take_mesh(w, err));
    SC_TRY(sc_make_model(w, err));
    for (i = 0; i < w->mesh.nodes; ++i) high = fmax(high, w->mesh.x[3 * (size_t)i + 2]);
    if (part > 0) sc_select(w, 2, -1, part * high, w->pin, &w->pins);
    if (part < 0) sc_select(w, 2, (1 + part) * high, 2, w->pin, &w->pins);
    def = sc_body_def(w);
    def.damage = &damage;
    sc_look_at(w, -0.5, 0.5, -0.5, 0.5, 0, high);
    SC_TRY(sc_add_body(w, &def, NULL, 0, err));
    return sc_touch_floor(w, 0, err);
}

static const sc_scene sc_scene_mesh = {
    "mesh", "Your mesh", "Drop an .obj, .stl, .ply, .off, .msh, .mesh, .vtk file here.",
    {SC_YOUNG(6e4), SC_POISSON(0.35), SC_DENSITY(1000), SC_DAMPING(1), SC_GRAVITY(9.81), SC_FRICTION(0.5), SC_RESTITUTION(0), SC_TETS(2500),
     {"held", "of the height", -0.3, 0.3, 0.04, 0, SC_AGAIN}, {"up", "axis", 0, 2, 1, 0, SC_AGAIN}, SC_STEP(1000 / 60.0),
     SC_ACCURACY(1e-6)},
    sc_mesh_create, NULL, NULL};

#endif
#endif
