/* page - what the page does in C: scenes, triangles to draw, picking, numbers. page.js calls it.
 *
 *     make web       clang compiles it to WebAssembly, twice, with and without SIMD; build/web/softfem.html holds both
 *     make test-web  compiles it natively, too: `native SCENE...` prints a hash of each after 300 steps, which has to
 *                    be that of the page
 *
 * softfem.h is compiled beside it with the same page.h.
 */
#include "page.h"
#include "softfem.h"
#include "../scenes/all.h"

/* --------------------------------------------------------------------------------------------
 * what is drawn of a body
 * -------------------------------------------------------------------------------------------- */

typedef struct vertex {
    float x[3], n[3], color; /* twice the number of the body's color, and 1 for inner faces */
} vertex;

#define DARK 100 /* the color of eyes */
#define STEEL 101 /* and of obstacles */

/* Vertices are split where triangles meet at an edge, so that normals are smooth elsewhere. */
typedef struct drawing {
    int count;            /* of vertices */
    sfem_int *point;      /* [count] the node, or vertex of the fragments */
    sfem_int *index;      /* [triangles][3] */
    unsigned char *inner; /* [count] */
    sfem_int triangles, points;
    double *x;            /* [points][3] */
    double broken, pieces; /* when it was made */
    int late;              /* pictures since then in which it would have been another */
    sfem_fragments fragments;
    sfem_embed *embed;
    sfem_embed_pieces parts;
} drawing;

static struct page {
    sc_world *w;
    drawing d[SC_ITEMS];
    vertex *vertex;
    uint32_t *index;
    int vertices, indices, changed;
    const sc_shape *shape; /* of which `skin` is */
    sfem_surface skin;     /* its arrays are the page's own, of malloc */
    sfem_int skin_own; /* triangles of it; those after them are eyes and a nose */
    sc_file file;
    char *file_bytes, file_name[64];
    double info[32], hand[7], arrow[1 + 6 * SC_OBSTACLES];
    sfem_error err;
    char *text;
} page;

static void forget(drawing *d)
{
    free(d->point);
    free(d->index);
    free(d->inner);
    free(d->x);
    sfem_fragments_free(&d->fragments);
    sfem_embed_free(d->embed);
    sfem_embed_pieces_free(&d->parts);
    memset(d, 0, sizeof *d);
}

static void forget_all(void)
{
    int k;
    for (k = 0; k < SC_ITEMS; ++k) forget(page.d + k);
    page.changed = 1;
}

static void normal_of(const double *x, const sfem_int *tri, double n[3])
{
    double e[2][3];
    int k, c;
    for (k = 0; k < 2; ++k)
        for (c = 0; c < 3; ++c) e[k][c] = x[3 * (size_t)tri[k + 1] + (size_t)c] - x[3 * (size_t)tri[0] + (size_t)c];
    for (c = 0; c < 3; ++c) n[c] = e[0][(c + 1) % 3] * e[1][(c + 2) % 3] - e[0][(c + 2) % 3] * e[1][(c + 1) % 3];
}

typedef struct corner_group { /* triangles around a vertex that are smooth together */
    sfem_int vertex, next;    /* the drawn one; another group of the same point, or -1 */
    double n[3];
    int inner;
} corner_group;

/* The group of a corner: that of a neighbour whose normal is within 45 degrees, on the same kind of face; or a new one. */
static sfem_int find_group(corner_group *group, sfem_int *groups, sfem_int *first, const double n[3], int inner)
{
    const double length = sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
    sfem_int g;
    int c;
    for (g = *first; g >= 0; g = group[g].next) {
        const double *m = group[g].n, size = sqrt(m[0] * m[0] + m[1] * m[1] + m[2] * m[2]);
        if (group[g].inner == inner && m[0] * n[0] + m[1] * n[1] + m[2] * n[2] >= 0.7 * length * size) break;
    }
    if (g < 0) {
        g = (*groups)++;
        memset(group + g, 0, sizeof *group);
        group[g].vertex = g;
        group[g].inner = inner;
        group[g].next = *first;
        *first = g;
    }
    for (c = 0; c < 3; ++c) group[g].n[c] += n[c];
    return g;
}

/* Fills d of triangles at their rest positions. normals: [count][3] of all groups, to be freed, or NULL. */
static int split(drawing *d, const double *x, sfem_int points, const sfem_int *tri, const unsigned char *inner,
                 sfem_int triangles, double **normals)
{
    const size_t corners = 3 * (size_t)triangles;
    corner_group *group = (corner_group *)calloc(corners, sizeof *group);
    sfem_int *first = (sfem_int *)malloc((size_t)points * sizeof *first), groups = 0, i;
    double n[3];
    int c;
    d->index = (sfem_int *)malloc(corners * sizeof *d->index);
    d->point = (sfem_int *)malloc(corners * sizeof *d->point);
    d->inner = (unsigned char *)malloc(corners);
    d->x = (double *)malloc(3 * (size_t)points * sizeof *d->x);
    if (!group || !first || !d->index || !d->point || !d->inner || !d->x) return free(group), free(first), 0;
    for (i = 0; i < points; ++i) first[i] = -1;
    for (i = 0; i < triangles; ++i) {
        normal_of(x, tri + 3 * i, n);
        for (c = 0; c < 3; ++c) {
            const sfem_int v = tri[3 * i + c], g = find_group(group, &groups, first + v, n, inner && inner[i]);
            d->index[3 * i + c] = g;
            d->point[g] = v;
            d->inner[g] = (unsigned char)(inner && inner[i]);
        }
    }
    d->count = groups;
    d->triangles = triangles;
    d->points = points;
    if (normals) {
        *normals = (double *)malloc(3 * (size_t)groups * sizeof **normals);
        for (i = 0; *normals && i < groups; ++i) memcpy(*normals + 3 * i, group[i].n, sizeof group[i].n);
    }
    free(group);
    free(first);
    return 1;
}

/* A ball joins a surface: rings of eight points between two poles. */
static int add_ball(sfem_surface *s, const double centre[3], double radius)
{
    enum { AROUND = 8, RINGS = 5, POINTS = AROUND * RINGS + 2, TRIANGLES = 2 * AROUND * RINGS };
    double *x = (double *)realloc(s->x, 3 * (size_t)(s->nodes + POINTS) * sizeof *x);
    sfem_int *tri, i, j, k = 0;
    if (x) s->x = x;
    tri = (sfem_int *)realloc(s->tri, 3 * (size_t)(s->triangles + TRIANGLES) * sizeof *tri);
    if (tri) s->tri = tri;
    if (!x || !tri) return 0;
    x += 3 * (size_t)s->nodes;
    tri += 3 * (size_t)s->triangles;
    for (i = 0; i < POINTS; ++i) { /* the poles come last */
        const double up = i < AROUND * RINGS ? SC_PI * (i / AROUND + 1.0) / (RINGS + 1) : i > AROUND * RINGS ? SC_PI : 0;
        const double around = 2 * SC_PI * (i % AROUND) / AROUND;
        x[3 * i] = centre[0] + radius * sin(up) * cos(around);
        x[3 * i + 1] = centre[1] + radius * sin(up) * sin(around);
        x[3 * i + 2] = centre[2] + radius * cos(up);
    }
    for (i = -1; i < RINGS; ++i)
        for (j = 0; j < AROUND; ++j) {
            const sfem_int next = (j + 1) % AROUND, a = AROUND * i + j, b = AROUND * i + next;
            const sfem_int c = a + AROUND, d = b + AROUND, top = AROUND * RINGS, below = top + 1;
            if (i >= 0) tri[k++] = a, tri[k++] = i < RINGS - 1 ? c : below, tri[k++] = b;
            if (i < RINGS - 1) tri[k++] = i < 0 ? top : b, tri[k++] = c, tri[k++] = d;
        }
    for (i = 0; i < k; ++i) tri[i] += s->nodes;
    s->nodes += POINTS;
    s->triangles += k / 3;
    return 1;
}

static int add_face(sfem_surface *s)
{
    static const double eye[2][3] = {{-0.068, -0.172, 0.822}, {0.068, -0.172, 0.822}}, nose[3] = {0, -0.236, 0.752};
    return add_ball(s, eye[0], 0.021) && add_ball(s, eye[1], 0.021) && add_ball(s, nose, 0.03);
}

/* The surface of the scene's shape, finer than its tets: made once. */
static sfem_status make_skin(const sc_shape *shape, sfem_error *err)
{
    sfem_mesher_def def = sfem_default_mesher_def();
    sfem_surface skin;
    sfem_mesh mesh;
    sfem_status status;
    if (page.shape == shape) return SFEM_OK;
    def.tets = 14000;
    SC_TRY(sfem_mesh_from_sdf(&def, shape->distance, NULL, shape->box, &mesh, NULL, err));
    status = sfem_mesh_surface(&mesh, NULL, &skin, err);
    if (status == SFEM_OK) {
        free(page.skin.x);
        free(page.skin.tri);
        page.shape = NULL;
        memset(&page.skin, 0, sizeof page.skin);
        page.skin.x = (double *)malloc(3 * (size_t)mesh.nodes * sizeof(double));
        page.skin.tri = (sfem_int *)malloc(3 * (size_t)skin.triangles * sizeof(sfem_int));
        if (!page.skin.x || !page.skin.tri) status = sc_fail(err, SFEM_OUT_OF_MEMORY, "out of memory");
    }
    if (status == SFEM_OK) {
        page.skin.nodes = mesh.nodes;
        page.skin.triangles = skin.triangles;
        memcpy(page.skin.x, mesh.x, 3 * (size_t)mesh.nodes * sizeof(double));
        memcpy(page.skin.tri, skin.tri, 3 * (size_t)skin.triangles * sizeof(sfem_int));
        sfem_surface_free(&skin);
    }
    sfem_mesh_free(&mesh);
    if (status != SFEM_OK) return status;
    page.skin_own = page.skin.triangles;
    page.shape = shape;
    if (shape == &sc_shape_bear && !add_face(&page.skin)) return sc_fail(err, SFEM_OUT_OF_MEMORY, "out of memory");
    return SFEM_OK;
}

/* A surface, that of the scene's shape or of the user's file, follows the tets. */
static sfem_status make_embed(drawing *d, const sfem_surface *skin, sfem_error *err)
{
    sfem_embed_def def = sfem_default_embed_def();
    double *x, *normal = NULL;
    sfem_status status;
    sfem_int i;
    int c;
    if (!split(d, skin->x, skin->nodes, skin->tri, NULL, skin->triangles, &normal))
        return sc_fail(err, SFEM_OUT_OF_MEMORY, "out of memory");
    x = (double *)malloc(3 * (size_t)d->count * sizeof *x);
    if (!x || !normal) return free(x), free(normal), sc_fail(err, SFEM_OUT_OF_MEMORY, "out of memory");
    for (i = 0; i < d->count; ++i)
        for (c = 0; c < 3; ++c) x[3 * i + c] = skin->x[3 * (size_t)d->point[i] + (size_t)c];
    def.points = d->count, def.x = x, def.normal = normal;
    def.triangles = d->triangles, def.tri = d->index;
    status = sfem_embed_create(&page.w->mesh, &def, &d->embed, err);
    free(x);
    free(normal);
    return status;
}

static sfem_status make_fragments(drawing *d, const sc_item *item, sfem_error *err)
{
    const sfem_fragments *f = &d->fragments;
    double *x;
    sfem_int i;
    int k, c, done;
    SC_TRY(sfem_body_fragments(item->body, NULL, &d->fragments, err));
    x = (double *)calloc(3 * (size_t)f->vertices, sizeof *x);
    if (!x) return sc_fail(err, SFEM_OUT_OF_MEMORY, "out of memory");
    for (i = 0; i < f->vertices; ++i) {
        int n = 0;
        for (k = 0; k < 4; ++k) n += f->simplex[4 * i + k] >= 0;
        for (k = 0; k < 4; ++k)
            for (c = 0; f->simplex[4 * i + k] >= 0 && c < 3; ++c)
                x[3 * i + c] += page.w->mesh.x[3 * (size_t)f->simplex[4 * i + k] + (size_t)c] / n;
    }
    done = split(d, x, f->vertices, f->tri, f->made, f->triangles, NULL);
    free(x);
    return done ? SFEM_OK : sc_fail(err, SFEM_OUT_OF_MEMORY, "out of memory");
}

/* Makes what is drawn of an item anew where something has broken: now, or, as that takes as long as a step and breaks come
 * one after another, in every third picture. */
static sfem_status refresh(int k, int now, sfem_error *err)
{
    const sc_item *item = page.w->item + k;
    drawing *d = page.d + k;
    double broken = 0, pieces = 1;
    if (item->body) {
        broken = sfem_body_fracture(item->body).broken;
        pieces = sfem_body_fracture(item->body).pieces;
    }
    if (d->embed ? d->pieces == pieces : d->count && d->broken == broken) return SFEM_OK;
    if (!now && d->count && ++d->late < 3) return SFEM_OK;
    d->late = 0;
    page.changed = 1;
    if (d->embed) {
        sfem_embed_pieces_free(&d->parts);
        SC_TRY(sfem_embed_break(d->embed, item->body, NULL, &d->parts, err));
    } else {
        forget(d);
        if (page.w->scene->shape) SC_TRY(make_skin(page.w->scene->shape, err));
        if (page.w->scene->shape) SC_TRY(make_embed(d, &page.skin, err));
        else if (page.file.skin.triangles && page.w->data) SC_TRY(make_embed(d, &page.file.skin, err));
        else if (broken > 0) SC_TRY(make_fragments(d, item, err));
        else if (!split(d, page.w->mesh.x, page.w->mesh.nodes, page.w->surface.tri, NULL, page.w->surface.triangles, NULL))
            return sc_fail(err, SFEM_OUT_OF_MEMORY, "out of memory");
    }
    d->broken = broken;
    d->pieces = pieces;
    return SFEM_OK;
}

/* Obstacles: balls and boxes. A floor is the page's own. */
enum { BALL_AROUND = 24, BALL_RINGS = 12 };

static int solid_vertices(sfem_obstacle_kind kind)
{
    return kind == SFEM_OBSTACLE_SPHERE ? (BALL_AROUND + 1) * (BALL_RINGS + 1) : kind == SFEM_OBSTACLE_BOX ? 24 : 0;
}

static int solid_indices(sfem_obstacle_kind kind)
{
    return kind == SFEM_OBSTACLE_SPHERE ? 6 * BALL_AROUND * BALL_RINGS : kind == SFEM_OBSTACLE_BOX ? 36 : 0;
}

static void index_solid(sfem_obstacle_kind kind, uint32_t *index, uint32_t first)
{
    static const uint32_t quad[6] = {0, 1, 3, 0, 3, 2};
    const int ball = kind == SFEM_OBSTACLE_SPHERE;
    int i, k;
    for (i = 0; i < solid_indices(kind) / 6; ++i)
        for (k = 0; k < 6; ++k) {
            const uint32_t row = (uint32_t)(ball ? i / BALL_AROUND : 0), at = (uint32_t)(ball ? i % BALL_AROUND : 4 * i);
            *index++ = first + (ball ? (row + (quad[k] >> 1)) * (BALL_AROUND + 1) + at + (quad[k] & 1) : at + quad[k]);
        }
}

/* Vertex i in the obstacle's own axes: its place over its size, and its normal. */
static void solid_point(sfem_obstacle_kind kind, int i, double y[3], double n[3])
{
    if (kind == SFEM_OBSTACLE_SPHERE) {
        const double a = 2 * SC_PI * (i % (BALL_AROUND + 1)) / BALL_AROUND, b = SC_PI * (i / (BALL_AROUND + 1)) / BALL_RINGS;
        y[0] = sin(b) * cos(a), y[1] = sin(b) * sin(a), y[2] = cos(b);
        memcpy(n, y, 3 * sizeof *n);
    } else {
        const int axis = i / 8, sign = i / 4 % 2 ? 1 : -1;
        n[0] = n[1] = n[2] = 0;
        y[axis] = n[axis] = sign;
        y[(axis + 1) % 3] = i % 2 ? 1 : -1;
        y[(axis + 2) % 3] = i / 2 % 2 ? 1 : -1;
    }
}

static void fill_solid(const sc_obstacle *o, vertex *v)
{
    double at[3], axes[9], y[3], n[3];
    int i, j, c;
    sfem_contact_obstacle_pose(page.w->contact, o->id, at, axes);
    for (i = 0; i < solid_vertices(o->def.kind); ++i) {
        solid_point(o->def.kind, i, y, n);
        for (c = 0; c < 3; ++c) y[c] *= o->def.size[o->def.kind == SFEM_OBSTACLE_SPHERE ? 0 : c];
        for (c = 0; c < 3; ++c)
            for (v[i].x[c] = (float)at[c], v[i].n[c] = 0, j = 0; j < 3; ++j) {
                v[i].x[c] += (float)(axes[3 * c + j] * y[j]);
                v[i].n[c] += (float)(axes[3 * c + j] * n[j]);
            }
    }
}

static int count_of(const drawing *d) { return d->parts.vertices ? d->parts.vertices : d->count; }
static int corners_of(const drawing *d) { return 3 * (d->parts.vertices ? d->parts.triangles : d->triangles); }

static sfem_status lay_out(sfem_error *err)
{
    sfem_int i;
    int k;
    page.vertices = page.indices = 0;
    for (k = 0; k < page.w->items; ++k) {
        page.vertices += count_of(page.d + k);
        page.indices += corners_of(page.d + k);
    }
    for (k = 0; k < page.w->obstacles; ++k) {
        page.vertices += solid_vertices(page.w->obstacle[k].def.kind);
        page.indices += solid_indices(page.w->obstacle[k].def.kind);
    }
    free(page.vertex);
    free(page.index);
    page.vertex = (vertex *)calloc((size_t)page.vertices + 1, sizeof *page.vertex);
    page.index = (uint32_t *)calloc((size_t)page.indices + 1, sizeof *page.index);
    if (!page.vertex || !page.index) return sc_fail(err, SFEM_OUT_OF_MEMORY, "out of memory");
    page.vertices = page.indices = 0;
    for (k = 0; k < page.w->items; ++k) {
        const drawing *d = page.d + k;
        const float color = (float)(2 * page.w->item[k].color);
        const sfem_int *from = d->parts.vertices ? d->parts.tri : d->index;
        for (i = 0; i < count_of(d); ++i)
            page.vertex[page.vertices + i].color = color + (float)(!d->parts.vertices && d->inner[i]);
        for (i = 0; d->embed && page.w->scene->shape && i < corners_of(d); ++i)
            if ((d->parts.vertices ? d->parts.source[i / 3] : i / 3) >= page.skin_own)
                page.vertex[page.vertices + from[i]].color = DARK;
        if (d->parts.vertices)
            for (i = 3 * (d->parts.triangles - d->parts.inner); i < 3 * d->parts.triangles; ++i)
                page.vertex[page.vertices + from[i]].color = color + 1;
        for (i = 0; i < corners_of(d); ++i) page.index[page.indices + i] = (uint32_t)(from[i] + page.vertices);
        page.vertices += count_of(d);
        page.indices += corners_of(d);
    }
    for (k = 0; k < page.w->obstacles; ++k) {
        const sfem_obstacle_kind kind = page.w->obstacle[k].def.kind;
        index_solid(kind, page.index + page.indices, (uint32_t)page.vertices);
        for (i = 0; i < solid_vertices(kind); ++i) page.vertex[page.vertices + i].color = STEEL;
        page.vertices += solid_vertices(kind);
        page.indices += solid_indices(kind);
    }
    return SFEM_OK;
}

static void fill(int k, vertex *v)
{
    const sc_item *item = page.w->item + k;
    drawing *d = page.d + k;
    sfem_int i;
    int c;
    if (d->parts.vertices) {
        sfem_embed_pieces_to_floats(d->embed, &d->parts, item->body, v->x, v->n, sizeof *v);
        return;
    }
    if (d->embed) {
        const double *u = page.w->x;
        if (item->body) u = sfem_body_displacement(item->body);
        else sfem_modal_displacements(item->modal, page.w->view, page.w->x);
        sfem_embed_to_floats(d->embed, u, v->x, v->n, sizeof *v);
        return;
    }
    if (d->fragments.vertices) sfem_body_fragment_positions(item->body, &d->fragments, d->x);
    else sc_positions(page.w, k, d->x);
    for (i = 0; i < d->count; ++i)
        for (c = 0; c < 3; ++c) v[i].x[c] = (float)d->x[3 * (size_t)d->point[i] + (size_t)c], v[i].n[c] = 0;
    for (i = 0; i < d->triangles; ++i) {
        sfem_int tri[3];
        double n[3];
        int j;
        for (c = 0; c < 3; ++c) tri[c] = d->point[d->index[3 * i + c]];
        normal_of(d->x, tri, n);
        for (j = 0; j < 3; ++j)
            for (c = 0; c < 3; ++c) v[d->index[3 * i + j]].n[c] += (float)n[c];
    }
}

/* --------------------------------------------------------------------------------------------
 * what page.js calls. Functions return a status; page_error has the sentence
 * -------------------------------------------------------------------------------------------- */

EXPORT(page_error) const char *page_error(void) { return page.err.text; }
EXPORT(page_new) void *page_new(int bytes) { return malloc((size_t)bytes); }
EXPORT(page_delete) void page_delete(void *memory) { free(memory); }

static void say(char *text, size_t room, const char *format, ...)
{
    const size_t used = strlen(text);
    va_list list;
    va_start(list, format);
    vsnprintf(text + used, room - used, format, list);
    va_end(list);
}

/* All scenes and their sliders, as JSON. */
EXPORT(page_scenes) const char *page_scenes(void)
{
    const size_t room = 1 << 15;
    int i, k;
    if (!page.text) page.text = (char *)calloc(room, 1);
    if (!page.text) return "[]";
    strcpy(page.text, "[");
    for (i = 0; i < SC_SCENES; ++i) {
        const sc_scene *s = sc_scenes[i];
        say(page.text, room, "%s{\"name\":\"%s\",\"title\":\"%s\",\"hint\":\"%s\",\"sliders\":[", i ? "," : "", s->name,
            s->title, s->hint);
        for (k = 0; k < SC_SLIDERS && s->slider[k].name; ++k)
            say(page.text, room,
                "%s{\"name\":\"%s\",\"unit\":\"%s\",\"low\":%.17g,\"high\":%.17g,\"value\":%.17g,\"log\":%d,\"again\":%d}",
                k ? "," : "", s->slider[k].name, s->slider[k].unit, s->slider[k].low, s->slider[k].high,
                s->slider[k].value, s->slider[k].log, s->slider[k].change == SC_AGAIN);
        say(page.text, room, "]}");
    }
    say(page.text, room, "]");
    return page.text;
}

/* Opens scene k with values [SC_SLIDERS], or NULL. On failure the one before goes on. */
EXPORT(page_open) int page_open(int k, const double *values)
{
    const int mesh = k == SC_SCENES - 1;
    sc_world *w;
    if (k < 0 || k >= SC_SCENES) return (int)sc_fail(&page.err, SFEM_BAD_ARGUMENT, "there is no scene %d", k);
    w = sc_open_with(sc_scenes[k], values, mesh && page.file_bytes ? &page.file : NULL, NULL, &page.err);
    if (!w) return (int)page.err.status;
    sc_close(page.w);
    page.w = w;
    forget_all();
    return SFEM_OK;
}

/* A file that was dropped: bytes, of page_new, become those of the page. */
EXPORT(page_file) int page_file(const char *name, char *bytes, int size, const double *values)
{
    struct page before = page;
    const size_t n = strlen(name);
    int status;
    memset(&page.file, 0, sizeof page.file);
    snprintf(page.file_name, sizeof page.file_name, "%s", n < sizeof page.file_name ? name : name + n - 40);
    page.file.name = page.file_name;
    page.file.bytes = page.file_bytes = bytes;
    page.file.size = (size_t)size;
    status = page_open(SC_SCENES - 1, values);
    if (status != SFEM_OK) {
        sfem_surface_free(&page.file.skin);
        free(bytes);
        page.file = before.file;
        page.file_bytes = before.file_bytes;
        memcpy(page.file_name, before.file_name, sizeof page.file_name);
        return status;
    }
    sfem_surface_free(&before.file.skin);
    free(before.file_bytes);
    return SFEM_OK;
}

EXPORT(page_set) int page_set(int slider, double value)
{
    const sc_world *before = page.w;
    const int status = (int)sc_set(&page.w, slider, value, &page.err);
    if (page.w != before) forget_all();
    return status;
}

EXPORT(page_step) int page_step(int steps) { return (int)sc_run(page.w, steps, &page.err); }

static sfem_status prepare_drawing(int now, sfem_error *err)
{
    vertex *v;
    int k;
    for (k = 0; k < page.w->items; ++k) SC_TRY(refresh(k, now, err));
    if (page.changed) SC_TRY(lay_out(err));
    for (v = page.vertex, k = 0; k < page.w->items; ++k) {
        fill(k, v);
        v += count_of(page.d + k);
    }
    for (k = 0; k < page.w->obstacles; ++k) {
        fill_solid(page.w->obstacle + k, v);
        v += solid_vertices(page.w->obstacle[k].def.kind);
    }
    return SFEM_OK;
}

/* Vertices and, after page_changed() = 1, indices for WebGL. now: 0 while pictures follow each other, see refresh. */
EXPORT(page_draw) int page_draw(int now) { return (int)prepare_drawing(now, &page.err); }

EXPORT(page_changed) int page_changed(void)
{
    const int changed = page.changed;
    page.changed = 0;
    return changed;
}

EXPORT(page_vertex) const void *page_vertex(void) { return page.vertex; }
EXPORT(page_index) const void *page_index(void) { return page.index; }
EXPORT(page_vertices) int page_vertices(void) { return page.vertices; }
EXPORT(page_indices) int page_indices(void) { return page.indices; }

/* Takes hold of what is there, or, poke = 1, puts a ball there: how far away, or -1, nothing, or -2, an error. */
EXPORT(page_grab) double page_grab(double ox, double oy, double oz, double dx, double dy, double dz, int poke)
{
    const double origin[3] = {ox, oy, oz}, direction[3] = {dx, dy, dz};
    double distance;
    page.changed = 1;
    return (poke ? sc_poke : sc_grab)(page.w, origin, direction, &distance, &page.err) == SFEM_OK ? distance : -2;
}

EXPORT(page_move) int page_move(double x, double y, double z)
{
    const double to[3] = {x, y, z};
    return (int)sc_move_hand(page.w, to, &page.err);
}

EXPORT(page_release) void page_release(void)
{
    page.changed = 1;
    sc_release(page.w);
}

/* from and to: [6] each; returns how many edges are marked, or -1. */
EXPORT(page_cut) int page_cut(const double *from, const double *to)
{
    int marked;
    return sc_cut(page.w, from, to, &marked, &page.err) == SFEM_OK ? marked : -1;
}

/* time, step, kinetic, elastic, load; rejected, corrections, pieces, broken; nodes, tets, bodies; box [6], floor, speed,
 * contacts, large pieces */
EXPORT(page_info) const double *page_info(void)
{
    const sc_measure m = sc_measure_all(page.w);
    const sc_world *w = page.w;
    double *p = page.info;
    int k;
    *p++ = w->time, *p++ = sc_step_length(w), *p++ = m.kinetic, *p++ = m.elastic, *p++ = m.load;
    *p++ = m.rejected, *p++ = m.corrections, *p++ = m.pieces, *p++ = m.broken;
    *p++ = w->mesh.nodes, *p++ = w->mesh.tets, *p++ = w->items;
    for (k = 0; k < 6; ++k) *p++ = w->box[k / 3][k % 3];
    *p++ = w->floor, *p++ = w->speed, *p++ = m.contacts, *p = m.large;
    return page.info;
}

/* 1 if it holds something, or there is the ball; where, m; the force, N. */
EXPORT(page_hand) const double *page_hand(void)
{
    page.hand[0] = sc_hand(page.w, page.hand + 1, page.hand + 4);
    return page.hand;
}

/* How many obstacles have a force to be shown; of each where, m, and what it feels, N. */
EXPORT(page_arrows) const double *page_arrows(void)
{
    double *p = page.arrow, axes[9];
    int k;
    for (*p++ = 0, k = 0; k < page.w->obstacles - page.w->poking; ++k) {
        if (!solid_vertices(page.w->obstacle[k].def.kind)) continue;
        sfem_contact_obstacle_pose(page.w->contact, page.w->obstacle[k].id, p, axes);
        sc_obstacle_force(page.w, k, p + 3);
        p += 6;
        ++page.arrow[0];
    }
    return page.arrow;
}

EXPORT(page_hash) const char *page_hash(void)
{
    static char text[20];
    snprintf(text, sizeof text, "%016llx", (unsigned long long)sc_hash(page.w));
    return text;
}

#ifndef __wasm__
/* "cut" or "cut:blade=0.5": its hash after 300 steps. */
static int run_scene(const char *text)
{
    double value[SC_SLIDERS];
    char name[32], slider[32];
    double set = 0;
    const int parts = sscanf(text, "%31[^:]:%31[^=]=%lf", name, slider, &set);
    int k, i;
    for (k = 0; k < SC_SCENES && strcmp(name, sc_scenes[k]->name); ++k) continue;
    if (k == SC_SCENES) return printf("there is no scene %s\n", name), 1;
    for (i = 0; i < SC_SLIDERS; ++i) value[i] = sc_scenes[k]->slider[i].value;
    i = parts == 3 ? sc_slider_of(sc_scenes[k], slider) : 0;
    if (i < 0) return printf("%s has no slider %s\n", name, slider), 1;
    if (parts == 3) value[i] = set;
    if (page_open(k, value) || page_step(300) || page_draw(1)) return printf("%s\n", page_error()), 1;
    printf("%s %s\n", text, page_hash());
    return 0;
}

int main(int count, char **names)
{
    int i;
    for (i = 1; i < count; ++i)
        if (run_scene(names[i])) return 1;
    (void)page_new, (void)page_delete, (void)page_scenes, (void)page_file, (void)page_set;
    (void)page_changed, (void)page_vertex, (void)page_index, (void)page_vertices, (void)page_indices, (void)page_grab;
    (void)page_move, (void)page_release, (void)page_cut, (void)page_info, (void)page_hand, (void)page_arrows;
    return 0;
}
#endif
