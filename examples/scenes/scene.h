/* scene.h - scenes as functions: a world, a driver, and sliders with units and ranges.
 *
 *     sc_world *w = sc_open(sc_find("tear"), NULL, &err);     NULL: all sliders at their defaults
 *     while (...) sc_step(w, &err);                           the driver acts, then all bodies step
 *     sc_set(w, sc_slider_of(w->scene, "pull"), 0.3, &err);   a slider is moved
 *     sc_grab(w, eye, direction, &distance, &err), sc_move_hand(w, to, &err), sc_release(w);
 *     sc_poke(w, eye, direction, &distance, &err);            the same with a ball
 *     sc_cut(w, from, to, &err);
 *     sc_close(w);
 *
 * Pure C99 on top of softfem.h, which is included first: no platform calls, no clock, no files, so that a scene gives
 * the same bits in every program that is compiled alike. examples/scenes/all.h has the list. A new scene is a header of
 * its own with one sc_scene, and a line in that list.
 */
#ifndef SFEM_EXAMPLES_SCENE_H
#define SFEM_EXAMPLES_SCENE_H

#include <math.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define SC_STATIC static __attribute__((unused))
#define SC_TRY(call)                                                                                                   \
    do {                                                                                                               \
        const sfem_status sc_status_ = (call);                                                                         \
        if (sc_status_ != SFEM_OK) return sc_status_;                                                                  \
    } while (0)

enum { SC_SLIDERS = 16, SC_ITEMS = 16, SC_HANDLES = 64, SC_PATCH = 512, SC_OBSTACLES = 8 };
#define SC_NO_FLOOR (-1e30)
#define SC_PI 3.14159265358979323846

/* What a change of a slider does: the scene starts again; it acts from the next step on; the bodies are made anew and
 * go on with their positions and velocities, unless something is broken: then the scene starts again. */
typedef enum sc_change { SC_AGAIN, SC_LIVE, SC_KEEP } sc_change;

typedef struct sc_slider {
    const char *name, *unit;
    double low, high, value; /* the range, and the default */
    int log;                 /* 1: a logarithmic scale */
    sc_change change;
} sc_slider;

/* The sliders that most scenes have, with a default of their own. */
#define SC_YOUNG(value) {"E", "Pa", 1e3, 1e8, value, 1, SC_KEEP}
#define SC_POISSON(value) {"nu", "", 0, 0.45, value, 0, SC_KEEP}
#define SC_DENSITY(value) {"density", "kg/m^3", 10, 1e4, value, 1, SC_KEEP}
#define SC_DAMPING(value) {"damping", "1/s", 0, 20, value, 0, SC_KEEP}
#define SC_GRAVITY(value) {"gravity", "m/s^2", 0, 20, value, 0, SC_LIVE}
#define SC_TOUGHNESS(value) {"toughness", "J/m^2", 1, 1e5, value, 1, SC_AGAIN}
#define SC_TETS(value) {"tets", "", 500, 12000, value, 1, SC_AGAIN}
#define SC_STEP(value) {"h", "ms", 0.25, 33.4, value, 1, SC_LIVE}
#define SC_FRICTION(value) {"friction", "", 0, 1.5, value, 0, SC_LIVE}
#define SC_RESTITUTION(value) {"restitution", "", 0, 1, value, 0, SC_LIVE}
#define SC_ACCURACY(value) {"accuracy", "", 1e-8, 1, value, 1, SC_KEEP}

typedef struct sc_world sc_world;

/* What the bodies of a scene are made of, for those who want it finer than the tets are, to draw it. */
typedef struct sc_shape {
    sfem_sdf distance;
    double box[2][3];
} sc_shape;

typedef struct sc_scene {
    const char *name, *title, *hint;
    sc_slider slider[SC_SLIDERS];                       /* those without a name are not there */
    sfem_status (*create)(sc_world *w, sfem_error *err); /* mesh, model, bodies, by the values of w */
    sfem_status (*drive)(sc_world *w, sfem_error *err);  /* before each step; or NULL */
    const sc_shape *shape;                               /* or NULL */
} sc_scene;

typedef struct sc_item {
    sfem_body *body; /* or */
#ifndef SFEM_NO_REDUCED
    sfem_modal *modal;
#endif
    double at[3]; /* m, where its rest shape was put */
    int color;    /* of a palette of the one who draws */
} sc_item;

#ifndef SFEM_NO_CONTACT
typedef struct sc_obstacle {
    sfem_obstacle_def def; /* its place is that where it was put */
    sfem_int id;
} sc_obstacle;
#endif

struct sc_world {
    const sc_scene *scene;
    double value[SC_SLIDERS];
    const void *data;    /* of the one who opens it, for create */
    const sc_world *like; /* for create: one with the same mesh, or NULL */
    sfem_mesh mesh;   /* all items have the same */
    sfem_surface surface;
    sfem_model *model;
#ifndef SFEM_NO_REDUCED
    sfem_reduced *reduced;
    sfem_reduced_view *view; /* all nodes */
#endif
#ifndef SFEM_NO_CONTACT
    sfem_contact *contact; /* or NULL: nothing is touched */
    sc_obstacle obstacle[SC_OBSTACLES];
#endif
    sc_item item[SC_ITEMS];
    int items, obstacles;
    double box[2][3]; /* m, what is worth looking at */
    double floor;     /* z, or SC_NO_FLOOR */
    double speed;     /* of its own time over that of a clock: below 1 in slow motion */
    double time;      /* s */
    int64_t steps;
    /* of drivers */
    sfem_int *pin, pins, *group, group_count; /* [nodes] each */
    double *x;                                /* [nodes][3], for whoever needs positions */
    sfem_int *whole;                          /* [tets][4], those of one piece each, to be picked */
    double way;
    int phase;
    sfem_int handle[SC_HANDLES];
    int handles;
    /* the hand */
    int holding; /* the item, or -1 */
    sfem_int hand;
    int poking;        /* 1: the last obstacle is the ball, */
    double ball_to[3]; /* m, and that is where it goes */
};

SC_STATIC sfem_status sc_fail(sfem_error *err, sfem_status status, const char *format, ...)
{
    va_list list;
    if (!err) return status;
    memset(err, 0, sizeof *err);
    err->status = status;
    err->node = err->tet = err->line = -1;
    va_start(list, format);
    vsnprintf(err->text, sizeof err->text, format, list);
    va_end(list);
    return status;
}

/* --------------------------------------------------------------------------------------------
 * sliders
 * -------------------------------------------------------------------------------------------- */

/* The slider's number, or -1. */
SC_STATIC int sc_slider_of(const sc_scene *scene, const char *name)
{
    int k;
    for (k = 0; k < SC_SLIDERS; ++k)
        if (scene->slider[k].name && !strcmp(scene->slider[k].name, name)) return k;
    return -1;
}

SC_STATIC double sc_value(const sc_world *w, const char *name, double otherwise)
{
    const int k = sc_slider_of(w->scene, name);
    return k < 0 ? otherwise : w->value[k];
}

SC_STATIC sfem_status sc_check(const sc_scene *scene, int k, double value, sfem_error *err)
{
    const sc_slider *s;
    if (k < 0 || k >= SC_SLIDERS || !scene->slider[k].name)
        return sc_fail(err, SFEM_BAD_ARGUMENT, "the scene %s has no slider %d", scene->name, k);
    s = scene->slider + k;
    if (!(value >= s->low && value <= s->high))
        return sc_fail(err, SFEM_BAD_ARGUMENT, "%s is %g, it has to be from %g to %g %s", s->name, value, s->low,
                       s->high, s->unit);
    return SFEM_OK;
}

/* --------------------------------------------------------------------------------------------
 * what scenes are made of
 * -------------------------------------------------------------------------------------------- */

/* After w->mesh is made: its surface, and the arrays of the drivers. */
SC_STATIC sfem_status sc_take_mesh(sc_world *w, sfem_error *err)
{
    const size_t n = (size_t)w->mesh.nodes;
    SC_TRY(sfem_mesh_surface(&w->mesh, NULL, &w->surface, err));
    w->pin = (sfem_int *)calloc(n, sizeof *w->pin);
    w->group = (sfem_int *)calloc(n, sizeof *w->group);
    w->x = (double *)calloc(3 * n, sizeof *w->x);
    w->whole = (sfem_int *)calloc(4 * (size_t)w->mesh.tets, sizeof *w->whole);
    if (!w->pin || !w->group || !w->x || !w->whole) return sc_fail(err, SFEM_OUT_OF_MEMORY, "out of memory");
    return SFEM_OK;
}

/* The mesh of w->like; 0 if there is none, or memory runs out. */
SC_STATIC int sc_same_mesh(sc_world *w)
{
    const sfem_mesh *from = w->like ? &w->like->mesh : NULL;
    return from && sfem_mesh_copy(from->nodes, from->x, from->tets, from->tet, NULL, &w->mesh, NULL) == SFEM_OK;
}

/* A block, its inner nodes moved by up to 1.5 `jitter`, so that cracks do not follow the cells. */
SC_STATIC sfem_status sc_block(sc_world *w, const sfem_int cells[3], const double size[3], double jitter,
                               sfem_error *err)
{
    uint64_t state = 4;
    sfem_int i;
    SC_TRY(sfem_mesh_block(cells, size, SFEM_CELL_5_TETS, NULL, &w->mesh, err));
    for (i = 0; jitter > 0 && i < 3 * w->mesh.nodes; ++i) {
        double *x = w->mesh.x + i, d;
        state = state * 6364136223846793005u + 1442695040888963407u;
        d = 1.5 * jitter * ((double)(state >> 11) / 4503599627370496.0 - 1);
        if (*x > 1e-9 && *x < size[i % 3] - 1e-9) *x += d;
    }
    return sc_take_mesh(w, err);
}

SC_STATIC sfem_status sc_make_model(sc_world *w, sfem_error *err)
{
    sfem_model_def def = sfem_default_model_def();
    def.mesh = &w->mesh;
    def.material.young = sc_value(w, "E", def.material.young);
    def.material.poisson = sc_value(w, "nu", def.material.poisson);
    def.material.density = sc_value(w, "density", def.material.density);
    def.material.mass_damping = sc_value(w, "damping", 0);
    return sfem_model_create(&def, &w->model, err);
}

SC_STATIC sfem_body_def sc_body_def(const sc_world *w)
{
    sfem_body_def def = sfem_default_body_def();
    def.gravity[2] = -sc_value(w, "gravity", 0);
    def.accuracy = sc_value(w, "accuracy", def.accuracy);
    def.pins = w->pin;
    def.pin_count = w->pins;
    def.refactorise = 4;
    return def;
}

/* What breaks by itself where the scene has a slider for its toughness; else by blades alone, and the fibres they leave. */
SC_STATIC sfem_damage_def sc_damage_def(const sc_world *w)
{
    sfem_damage_def damage = sfem_default_damage_def();
    damage.toughness = sc_value(w, "toughness", 1e9);
    return damage;
}

SC_STATIC sfem_status sc_add_body(sc_world *w, const sfem_body_def *def, const double *at, int color, sfem_error *err)
{
    sc_item *item = w->item + w->items;
    if (w->items == SC_ITEMS) return sc_fail(err, SFEM_FULL, "more than %d bodies", SC_ITEMS);
    SC_TRY(sfem_body_create(w->model, def, &item->body, err));
    ++w->items;
    item->color = color;
    if (!at) return SFEM_OK;
    memcpy(item->at, at, sizeof item->at);
    return sfem_body_place(item->body, NULL, at, err);
}

#ifndef SFEM_NO_CONTACT
SC_STATIC sfem_contact_surface sc_contact_surface(const sc_world *w)
{
    sfem_contact_surface surface = sfem_default_contact_surface();
    surface.friction = sc_value(w, "friction", surface.friction);
    surface.restitution = sc_value(w, "restitution", surface.restitution);
    return surface;
}

/* The bodies so far touch obstacles. Where they did before: those there are, with the present sliders. */
SC_STATIC sfem_status sc_touch(sc_world *w, sfem_error *err)
{
    const sfem_contact_surface surface = sc_contact_surface(w);
    int k;
    for (k = 0; w->contact && k < w->obstacles; ++k)
        sfem_contact_obstacle_pose(w->contact, w->obstacle[k].id, w->obstacle[k].def.position, w->obstacle[k].def.rotation);
    sfem_contact_free(w->contact);
    w->contact = NULL;
    SC_TRY(sfem_contact_create(NULL, &w->contact, err));
    for (k = 0; k < w->items; ++k)
        if (w->item[k].body) SC_TRY(sfem_contact_add_body(w->contact, w->item[k].body, &surface, ~0u, NULL, err));
    for (k = 0; k < w->obstacles; ++k) {
        w->obstacle[k].def.contact = surface;
        SC_TRY(sfem_contact_add_obstacle(w->contact, &w->obstacle[k].def, &w->obstacle[k].id, err));
    }
    return SFEM_OK;
}

/* Its number is that of w->obstacles before. */
SC_STATIC sfem_status sc_add_obstacle(sc_world *w, const sfem_obstacle_def *def, sfem_error *err)
{
    sc_obstacle *o = w->obstacle + w->obstacles;
    if (w->obstacles == SC_OBSTACLES) return sc_fail(err, SFEM_FULL, "more than %d obstacles", SC_OBSTACLES);
    if (!w->contact) SC_TRY(sc_touch(w, err));
    o->def = *def;
    o->def.contact = sc_contact_surface(w);
    SC_TRY(sfem_contact_add_obstacle(w->contact, &o->def, &o->id, err));
    ++w->obstacles;
    return SFEM_OK;
}

/* The bodies so far touch a floor at this height. */
SC_STATIC sfem_status sc_touch_floor(sc_world *w, double floor, sfem_error *err)
{
    const double up[3] = {0, 0, 1}, at[3] = {0, 0, floor};
    const sfem_obstacle_def plane = sfem_obstacle_plane(up, at);
    w->floor = floor;
    return sc_add_obstacle(w, &plane, err);
}

/* What the bodies exerted on an obstacle in the last step, N. */
SC_STATIC void sc_obstacle_force(const sc_world *w, int k, double force[3])
{
    double torque[3];
    sfem_contact_obstacle_force(w->contact, w->obstacle[k].id, force, torque);
}

/* In the next step, and all further ones. */
SC_STATIC sfem_status sc_move_obstacle(sc_world *w, int k, const double velocity[3], sfem_error *err)
{
    double at[3], axes[9];
    sfem_contact_obstacle_pose(w->contact, w->obstacle[k].id, at, axes);
    return sfem_contact_move_obstacle(w->contact, w->obstacle[k].id, at, NULL, velocity, NULL, err);
}

/* The ball goes to where it should be, by half of the way in a step and by no more than half of its radius, so that it
 * passes nothing; in short steps as fast as in those of 1/60 s. */
SC_STATIC sfem_status sc_move_ball(sc_world *w, double h, sfem_error *err)
{
    const sc_obstacle *ball = w->obstacle + w->obstacles - 1;
    double at[3], axes[9], v[3], rate = fmin(0.5 / h, 30), far;
    int c;
    sfem_contact_obstacle_pose(w->contact, ball->id, at, axes);
    for (c = 0; c < 3; ++c) v[c] = w->ball_to[c] - at[c];
    far = sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
    if (far > ball->def.size[0]) rate *= ball->def.size[0] / far;
    for (c = 0; c < 3; ++c) v[c] *= rate;
    return sfem_contact_move_obstacle(w->contact, ball->id, at, NULL, v, NULL, err);
}
#else
SC_STATIC sfem_status sc_touch_floor(sc_world *w, double floor, sfem_error *err)
{
    (void)err;
    w->floor = floor;
    return SFEM_OK;
}
#endif

/* How many there are, and [3] of each, m. */
SC_STATIC void sc_positions(const sc_world *w, int item, double *x)
{
#ifndef SFEM_NO_REDUCED
    if (w->item[item].modal) {
        sfem_modal_positions(w->item[item].modal, w->view, x);
        return;
    }
#endif
    sfem_body_positions(w->item[item].body, x);
}

SC_STATIC void sc_look_at(sc_world *w, double x0, double x1, double y0, double y1, double z0, double z1)
{
    w->box[0][0] = x0, w->box[0][1] = y0, w->box[0][2] = z0;
    w->box[1][0] = x1, w->box[1][1] = y1, w->box[1][2] = z1;
}

/* --------------------------------------------------------------------------------------------
 * a world
 * -------------------------------------------------------------------------------------------- */

SC_STATIC void sc_close(sc_world *w)
{
    int k;
    if (!w) return;
#ifndef SFEM_NO_CONTACT
    sfem_contact_free(w->contact);
#endif
    for (k = 0; k < w->items; ++k) {
        sfem_body_free(w->item[k].body);
#ifndef SFEM_NO_REDUCED
        sfem_modal_free(w->item[k].modal);
#endif
    }
#ifndef SFEM_NO_REDUCED
    sfem_reduced_view_free(w->view);
    sfem_reduced_free(w->reduced);
#endif
    sfem_model_free(w->model);
    sfem_surface_free(&w->surface);
    sfem_mesh_free(&w->mesh);
    free(w->pin);
    free(w->group);
    free(w->x);
    free(w->whole);
    free(w);
}

/* values: [SC_SLIDERS], or NULL for the defaults; data, like: see sc_world. NULL on failure. */
SC_STATIC sc_world *sc_open_with(const sc_scene *scene, const double *values, const void *data, const sc_world *like,
                                 sfem_error *err)
{
    sc_world *w = (sc_world *)calloc(1, sizeof *w);
    sfem_status status = SFEM_OK;
    int k;
    if (!w) {
        (void)sc_fail(err, SFEM_OUT_OF_MEMORY, "out of memory");
        return NULL;
    }
    w->scene = scene;
    w->data = data;
    w->like = like;
    w->holding = -1;
    w->floor = SC_NO_FLOOR;
    w->speed = 1;
    sc_look_at(w, -0.5, 0.5, -0.5, 0.5, 0, 1);
    for (k = 0; k < SC_SLIDERS; ++k) {
        w->value[k] = values ? values[k] : scene->slider[k].value;
        if (status == SFEM_OK && scene->slider[k].name) status = sc_check(scene, k, w->value[k], err);
    }
    if (status == SFEM_OK) status = scene->create(w, err);
    w->like = NULL;
    if (status == SFEM_OK) return w;
    sc_close(w);
    return NULL;
}

SC_STATIC sc_world *sc_open(const sc_scene *scene, const double *values, sfem_error *err)
{
    return sc_open_with(scene, values, NULL, NULL, err);
}

SC_STATIC double sc_step_length(const sc_world *w) { return 1e-3 * sc_value(w, "h", 1000 / 60.0); }

/* On failure the bodies before the one that failed have stepped. */
SC_STATIC sfem_status sc_step(sc_world *w, sfem_error *err)
{
    const double h = sc_step_length(w);
    int k;
    if (w->scene->drive) SC_TRY(w->scene->drive(w, err));
    for (k = 0; k < w->items; ++k) {
#ifndef SFEM_NO_REDUCED
        if (w->item[k].modal) SC_TRY(sfem_modal_step(w->item[k].modal, h, err));
#endif
#ifndef SFEM_NO_CONTACT
        if (w->contact) continue;
#endif
        if (w->item[k].body) SC_TRY(sfem_body_step(w->item[k].body, h, err));
    }
#ifndef SFEM_NO_CONTACT
    if (w->poking) SC_TRY(sc_move_ball(w, h, err));
    if (w->contact) SC_TRY(sfem_contact_step(w->contact, h, err));
#endif
    w->time += h;
    ++w->steps;
    return SFEM_OK;
}

SC_STATIC sfem_status sc_run(sc_world *w, int steps, sfem_error *err)
{
    while (steps-- > 0) SC_TRY(sc_step(w, err));
    return SFEM_OK;
}

/* --------------------------------------------------------------------------------------------
 * the hand, the ball, the blade
 * -------------------------------------------------------------------------------------------- */

SC_STATIC void sc_release(sc_world *w)
{
#ifndef SFEM_NO_CONTACT
    if (w->poking) sfem_contact_remove_obstacle(w->contact, w->obstacle[--w->obstacles].id);
    w->poking = 0;
#endif
    if (w->holding < 0) return;
#ifndef SFEM_NO_REDUCED
    if (w->item[w->holding].modal) sfem_modal_release_handle(w->item[w->holding].modal, w->hand);
#endif
    if (w->item[w->holding].body) sfem_body_release_handle(w->item[w->holding].body, w->hand);
    w->holding = -1;
}

/* The tet, its nodes, that a ray meets first in an item, but not those between two pieces, which are not drawn. */
SC_STATIC int sc_pick(sc_world *w, int item, const double origin[3], const double direction[3], sfem_int tet[4],
                      double bary[4], double *distance)
{
    sfem_mesh mesh = w->mesh;
    sfem_int t;
#ifndef SFEM_NO_DAMAGE
    if (w->item[item].body && sfem_body_fracture(w->item[item].body).pieces > 1) {
        const sfem_int *piece = sfem_body_piece_of(w->item[item].body);
        mesh.tet = w->whole;
        for (mesh.tets = 0, t = 0; t < w->mesh.tets; ++t) {
            const sfem_int *v = w->mesh.tet + 4 * (size_t)t;
            if (piece[v[0]] == piece[v[1]] && piece[v[0]] == piece[v[2]] && piece[v[0]] == piece[v[3]])
                memcpy(w->whole + 4 * (size_t)mesh.tets++, v, 4 * sizeof *v);
        }
    }
#endif
    sc_positions(w, item, w->x);
    if (!sfem_mesh_pick_ray(&mesh, w->x, origin, direction, &t, bary, distance)) return 0;
    memcpy(tet, mesh.tet + 4 * (size_t)t, 4 * sizeof *tet);
    return 1;
}

/* Nodes near a point of a tet that belong to its piece, with weights that sum to 1. */
SC_STATIC sfem_status sc_patch(sc_world *w, int item, const sfem_int *tet, const double bary[4], sfem_int *node,
                               double *weight, sfem_int *count, sfem_error *err)
{
    const sfem_int *piece = NULL;
    sfem_patch patch;
    double sum = 0;
    sfem_int i, kept = 0;
    int k, c, best = 0;
    memset(&patch, 0, sizeof patch);
    patch.x = w->x;
    patch.radius = 0.06 * hypot(w->box[1][0] - w->box[0][0], w->box[1][2] - w->box[0][2]);
    for (k = 0; k < 4; ++k) {
        if (bary[k] > bary[best]) best = k;
        for (c = 0; c < 3; ++c) patch.point[c] += bary[k] * w->x[3 * (size_t)tet[k] + (size_t)c];
    }
    while (sfem_mesh_near(&w->mesh, &patch, SC_PATCH, node, weight, count, err) == SFEM_FULL) patch.radius *= 0.8;
#ifndef SFEM_NO_DAMAGE
    if (w->item[item].body && sfem_body_fracture(w->item[item].body).broken)
        piece = sfem_body_piece_of(w->item[item].body);
#endif
    (void)item;
    for (i = 0; i < *count; ++i) {
        if (piece && piece[node[i]] != piece[tet[best]]) continue;
        node[kept] = node[i];
        weight[kept] = weight[i];
        sum += weight[kept++];
    }
    if (!(sum > 0)) node[0] = tet[best], weight[0] = sum = 1, kept = 1;
    for (i = 0; i < kept; ++i) weight[i] /= sum;
    *count = kept;
    return SFEM_OK;
}

/* The item that a ray meets first, or -1: where in it, and how far away, m, else < 0. */
SC_STATIC int sc_pick_first(sc_world *w, const double origin[3], const double direction[3], sfem_int tet[4], double bary[4],
                            double *distance)
{
    sfem_int t[4];
    double b[4], d;
    int k, item = -1;
    *distance = -1;
    for (k = 0; k < w->items; ++k) {
        if (!sc_pick(w, k, origin, direction, t, b, &d) || (item >= 0 && d >= *distance)) continue;
        item = k, *distance = d;
        memcpy(tet, t, sizeof t);
        memcpy(bary, b, sizeof b);
    }
    return item;
}

/* Takes hold of what a ray meets first. *distance: how far away, m, or < 0: nothing is there. */
SC_STATIC sfem_status sc_grab(sc_world *w, const double origin[3], const double direction[3], double *distance,
                              sfem_error *err)
{
    sfem_int node[SC_PATCH], count, tet[4] = {0, 0, 0, 0};
    double weight[SC_PATCH], bary[4] = {0, 0, 0, 0};
    int item;
    sc_release(w);
    item = sc_pick_first(w, origin, direction, tet, bary, distance);
    if (item < 0) return SFEM_OK;
    sc_positions(w, item, w->x);
    SC_TRY(sc_patch(w, item, tet, bary, node, weight, &count, err));
#ifndef SFEM_NO_REDUCED
    if (w->item[item].modal)
        SC_TRY(sfem_modal_grab_region(w->item[item].modal, count, node, weight, &w->hand, err));
#endif
    if (w->item[item].body) SC_TRY(sfem_body_grab_region(w->item[item].body, count, node, weight, &w->hand, err));
    w->holding = item;
    return SFEM_OK;
}

#ifndef SFEM_NO_CONTACT
/* Is no node so near to x? */
SC_STATIC int sc_is_free(sc_world *w, const double x[3], double radius)
{
    sfem_int i;
    int k;
    for (k = 0; k < w->items; ++k) {
        sc_positions(w, k, w->x);
        for (i = 0; i < w->mesh.nodes; ++i) {
            const double *y = w->x + 3 * (size_t)i;
            if (hypot(hypot(x[0] - y[0], x[1] - y[1]), x[2] - y[2]) < radius) return 0;
        }
    }
    return 1;
}

/* A ball goes along a ray until its centre is where the ray meets a body first, or else where it passes the middle of the
 * scene. It begins as near to that as it can without a node inside. *distance: how far away that is, m. */
SC_STATIC sfem_status sc_poke(sc_world *w, const double origin[3], const double direction[3], double *distance, sfem_error *err)
{
    sfem_obstacle_def ball = sfem_default_obstacle_def();
    sfem_int tet[4];
    double bary[4], back, length = 0;
    int c, met, tries;
    sc_release(w);
    for (c = 0; c < w->items; ++c)
        if (!w->item[c].body) return sc_fail(err, SFEM_BAD_ARGUMENT, "modal scenes have no ball: choose another scene to poke at");
    for (c = 0; c < 3; ++c) length += direction[c] * direction[c];
    met = sc_pick_first(w, origin, direction, tet, bary, distance) >= 0;
    for (*distance = met ? *distance : 0, c = 0; c < 3 && !met; ++c)
        *distance += direction[c] * (0.5 * (w->box[0][c] + w->box[1][c]) - origin[c]) / length;
    ball.kind = SFEM_OBSTACLE_SPHERE;
    ball.size[0] = 0.06 * hypot(w->box[1][0] - w->box[0][0], w->box[1][2] - w->box[0][2]);
    for (back = 0, tries = 0; tries < 100; ++tries, back += 0.5 * ball.size[0] / sqrt(length)) {
        for (c = 0; c < 3; ++c) ball.position[c] = origin[c] + (*distance - back) * direction[c];
        if (sc_is_free(w, ball.position, 1.05 * ball.size[0])) break;
    }
    for (c = 0; c < 3; ++c) w->ball_to[c] = origin[c] + *distance * direction[c];
    SC_TRY(sc_add_obstacle(w, &ball, err));
    w->poking = 1;
    return SFEM_OK;
}
#endif

/* Where the hand, or the ball, goes. */
SC_STATIC sfem_status sc_move_hand(sc_world *w, const double to[3], sfem_error *err)
{
#ifndef SFEM_NO_CONTACT
    if (w->poking && !(fabs(to[0]) + fabs(to[1]) + fabs(to[2]) < 1e9))
        return sc_fail(err, SFEM_NOT_FINITE, "the ball cannot go to (%g, %g, %g)", to[0], to[1], to[2]);
    if (w->poking) memcpy(w->ball_to, to, sizeof w->ball_to);
#endif
    if (w->holding < 0) return SFEM_OK;
#ifndef SFEM_NO_REDUCED
    if (w->item[w->holding].modal) return sfem_modal_move_handle(w->item[w->holding].modal, w->hand, to, err);
#endif
    return sfem_body_move_handle(w->item[w->holding].body, w->hand, to, err);
}

/* Where the hand holds the body, m, or the ball is, and the pull or push of it on the body, N. 0 if there is none. */
SC_STATIC int sc_hand(const sc_world *w, double x[3], double force[3])
{
#ifndef SFEM_NO_CONTACT
    if (w->poking) {
        double axes[9];
        int c;
        sc_obstacle_force(w, w->obstacles - 1, force);
        for (c = 0; c < 3; ++c) force[c] = -force[c];
        sfem_contact_obstacle_pose(w->contact, w->obstacle[w->obstacles - 1].id, x, axes);
        return 1;
    }
#endif
    if (w->holding < 0) return 0;
#ifndef SFEM_NO_REDUCED
    if (w->item[w->holding].modal) {
        sfem_modal_handle_position(w->item[w->holding].modal, w->hand, x);
        sfem_modal_handle_force(w->item[w->holding].modal, w->hand, force);
        return 1;
    }
#endif
    sfem_body_handle_position(w->item[w->holding].body, w->hand, x);
    sfem_body_handle_force(w->item[w->holding].body, w->hand, force);
    return 1;
}

#ifndef SFEM_NO_DAMAGE
/* A blade, the segment from[0..2] from[3..5], moves to another place and cuts what is between. marked: edges. */
SC_STATIC sfem_status sc_cut(sc_world *w, const double from[6], const double to[6], int *marked, sfem_error *err)
{
    double a[9], b[9];
    sfem_int count;
    int k;
    memcpy(a, from, 6 * sizeof *a);
    memcpy(b, to, 6 * sizeof *b);
    memcpy(a + 6, from + 3, 3 * sizeof *a); /* a triangle with two corners at one place */
    memcpy(b + 6, to + 3, 3 * sizeof *b);
    *marked = 0;
    for (k = 0; k < w->items; ++k) {
        if (!w->item[k].body) continue;
        SC_TRY(sfem_body_cut(w->item[k].body, a, b, &count, err));
        *marked += (int)count;
    }
    return SFEM_OK;
}
#endif

/* --------------------------------------------------------------------------------------------
 * a slider is moved
 * -------------------------------------------------------------------------------------------- */

/* The bodies of `to` go on where those of `from` are. */
SC_STATIC sfem_status sc_go_on(sc_world *to, const sc_world *from, sfem_error *err)
{
    const size_t n = 3 * (size_t)from->mesh.nodes;
    double *v;
    sfem_status status = SFEM_OK;
    int k;
    if (from->items != to->items || from->obstacles - from->poking != to->obstacles || from->mesh.nodes != to->mesh.nodes || from->phase || from->handles) return SFEM_OK;
    for (k = 0; k < from->items; ++k)
        if (!from->item[k].body || sfem_body_fracture(from->item[k].body).broken) return SFEM_OK;
    v = (double *)calloc(n, sizeof *v);
    if (!v) return sc_fail(err, SFEM_OUT_OF_MEMORY, "out of memory");
    for (k = 0; k < from->items && status == SFEM_OK; ++k) {
        /* a pin holds its node where that is when it is pinned, so pins come last */
        status = sfem_body_set_pins(to->item[k].body, 0, NULL, NULL, err);
        if (status != SFEM_OK) break;
        sfem_body_velocities(from->item[k].body, v);
        status = sfem_body_set_state(to->item[k].body, sfem_body_displacement(from->item[k].body), v, err);
        if (status == SFEM_OK) status = sfem_body_set_pins(to->item[k].body, from->pins, from->pin, NULL, err);
    }
    free(v);
#ifndef SFEM_NO_CONTACT
    for (k = 0; k < to->obstacles && status == SFEM_OK; ++k) {
        double at[3], axes[9];
        sfem_contact_obstacle_pose(from->contact, from->obstacle[k].id, at, axes);
        status = sfem_contact_move_obstacle(to->contact, to->obstacle[k].id, at, axes, NULL, NULL, err);
    }
#endif
    to->time = from->time;
    to->steps = from->steps;
    to->way = from->way;
    return status;
}

/* Sets a slider. The world may be replaced by another one: *at is the one to go on with. On failure all is as it was. */
SC_STATIC sfem_status sc_set(sc_world **at, int k, double value, sfem_error *err)
{
    sc_world *w = *at, *next;
    double values[SC_SLIDERS];
    int i;
    SC_TRY(sc_check(w->scene, k, value, err));
    if (w->scene->slider[k].change == SC_LIVE) {
        const int of_contact = !strcmp(w->scene->slider[k].name, "friction") || !strcmp(w->scene->slider[k].name, "restitution");
        w->value[k] = value;
        for (i = 0; i < w->items; ++i) {
            const double g[3] = {0, 0, -sc_value(w, "gravity", 0)};
            if (w->item[i].body) SC_TRY(sfem_body_set_gravity(w->item[i].body, g, err));
        }
#ifndef SFEM_NO_CONTACT
        if (of_contact && w->contact) return sc_touch(w, err);
#endif
        (void)of_contact;
        return SFEM_OK;
    }
    memcpy(values, w->value, sizeof values);
    values[k] = value;
    next = sc_open_with(w->scene, values, w->data, w->scene->slider[k].change == SC_KEEP ? w : NULL, err);
    if (!next) return err ? err->status : SFEM_BAD_ARGUMENT;
    if (w->scene->slider[k].change == SC_KEEP && sc_go_on(next, w, err) != SFEM_OK) {
        sc_close(next);
        return err ? err->status : SFEM_BAD_ARGUMENT;
    }
    sc_close(w);
    *at = next;
    return SFEM_OK;
}

/* --------------------------------------------------------------------------------------------
 * what is measured
 * -------------------------------------------------------------------------------------------- */

typedef struct sc_measure {
    double kinetic, elastic, load; /* J */
    double rejected, corrections;  /* steps so far; of the last step, the largest of all bodies */
    double pieces, broken;         /* of all bodies together; edges */
    double large;                  /* pieces of at least a twentieth of a body's nodes */
    double contacts;               /* with obstacles, in the last step */
} sc_measure;

/* How many pieces of a body have at least a twentieth of its nodes. */
SC_STATIC double sc_large_pieces(const sc_world *w, const sfem_body *body)
{
    double large = 1;
#ifndef SFEM_NO_DAMAGE
    const sfem_int pieces = sfem_body_fracture(body).pieces, *piece;
    sfem_int *nodes, i;
    if (pieces < 2) return 1;
    nodes = (sfem_int *)calloc((size_t)pieces, sizeof *nodes);
    if (!nodes) return 0;
    piece = sfem_body_piece_of(body);
    for (i = 0; i < w->mesh.nodes; ++i)
        if (piece[i] >= 0) ++nodes[piece[i]];
    for (large = 0, i = 0; i < pieces; ++i) large += 20 * nodes[i] >= w->mesh.nodes;
    free(nodes);
#else
    (void)w, (void)body;
#endif
    return large;
}

SC_STATIC sc_measure sc_measure_all(sc_world *w)
{
    sc_measure m;
    int k;
    memset(&m, 0, sizeof m);
#ifndef SFEM_NO_CONTACT
    if (w->contact) m.contacts = (double)sfem_contact_get_info(w->contact).contacts;
#endif
    for (k = 0; k < w->items; ++k) {
        sfem_body *body = w->item[k].body;
        if (body) {
            const sfem_energy e = sfem_body_energy(body);
            const sfem_body_info info = sfem_body_get_info(body);
            m.kinetic += e.kinetic;
            m.elastic += e.elastic;
            m.load += e.load;
            m.rejected += (double)info.rejected;
            m.corrections = fmax(m.corrections, (double)info.corrections);
            m.large += sc_large_pieces(w, body);
#ifndef SFEM_NO_DAMAGE
            m.pieces += (double)sfem_body_fracture(body).pieces;
            m.broken += (double)sfem_body_fracture(body).broken;
        } else {
#else
            m.pieces += 1;
        } else {
#endif
#ifndef SFEM_NO_REDUCED
            const sfem_reduced_info info = sfem_reduced_get_info(w->reduced);
            const double *q = sfem_modal_coordinates(w->item[k].modal);
            const double *v = sfem_modal_coordinate_velocities(w->item[k].modal);
            sfem_int i;
            for (i = 0; i < info.modes; ++i) {
                m.kinetic += 0.5 * v[i] * v[i];
                m.elastic += 0.5 * info.lambda[i] * q[i] * q[i];
            }
            m.pieces += 1;
#endif
        }
    }
    return m;
}

#if !defined SFEM_NO_DAMAGE && !defined SFEM_NO_CONTACT
/* What the bodies have over what was put in, over their scale: the errors of their energy balances, less the work of contacts,
 * which these do not contain. 0 of modal bodies. */
SC_STATIC double sc_energy_made(const sc_world *w)
{
    double error = w->contact ? -sfem_contact_get_info(w->contact).work : 0, scale = 0;
    int k;
    for (k = 0; k < w->items; ++k) {
        sfem_fracture f;
        if (!w->item[k].body) return 0;
        f = sfem_body_fracture(w->item[k].body);
        error += f.error;
        scale += f.scale;
    }
    return scale > 0 ? error / scale : 0;
}
#endif

/* FNV-1a of all positions, bit by bit. */
SC_STATIC uint64_t sc_hash(sc_world *w)
{
    const size_t bytes = 3 * (size_t)w->mesh.nodes * sizeof *w->x;
    uint64_t hash = 14695981039346656037u;
    size_t i;
    int k;
    for (k = 0; k < w->items; ++k) {
        sc_positions(w, k, w->x);
        for (i = 0; i < bytes; ++i) hash = (hash ^ ((const unsigned char *)w->x)[i]) * 1099511628211u;
    }
    return hash;
}

#endif
