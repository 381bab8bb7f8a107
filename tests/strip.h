/* strip.h - a clamped strip with a crack, whose energy release rate is known; shared by tests and benches.
 *
 *      top, moved up                 length 3 m, height 1 m, a thickness of some cells
 *     =====================          crack of 0.9 m at half height, by a blade
 *     <--------   W            z
 *     =====================    |__x  G = W H: W J/m^3 of the strip ahead of the crack, H its height [Rivlin, Thomas 1953]
 *      bottom, moved down
 *
 *     strip_mesh(kind, n, thick, seed, &mesh, &err)   n cells over the height
 *     strip_pull(&strip, &result)                     until it parts, or up to a part of Griffith's displacement
 */
#ifndef SFEM_TESTS_STRIP_H
#define SFEM_TESTS_STRIP_H

#include "bodies.h"

enum { STRIP_5_TETS, STRIP_6_TETS, STRIP_CENTRED, STRIP_DELAUNAY, STRIP_KINDS };

static const char *const strip_name[STRIP_KINDS] = {"5-tet cells", "6-tet cells", "body-centred cells", "Delaunay"};

#define STRIP_LENGTH 3.0
#define STRIP_CRACK  0.9001

/* Cells whose centres are nodes, too: four tets round each line between neighbouring centres, two to a face outside. */
BODY_STATIC sfem_status strip_centred(int nx, int ny, int nz, sfem_mesh *out, sfem_error *err)
{
    const int n[3] = {nx, ny, nz}, corners = (nx + 1) * (ny + 1) * (nz + 1);
    double *x = (double *)body_new(3 * (size_t)(corners + nx * ny * nz), sizeof *x);
    sfem_int *tet = (sfem_int *)body_new(4 * 24 * (size_t)(nx * ny * nz), sizeof *tet);
    sfem_int tets = 0, nodes = 0;
    sfem_status status;
    int centre, axis, i, j, k, s;
    for (centre = 0; centre < 2; ++centre)
        for (i = 0; i <= nx - centre; ++i)
            for (j = 0; j <= ny - centre; ++j)
                for (k = 0; k <= nz - centre; ++k, ++nodes) {
                    x[3 * nodes] = (i + 0.5 * centre) / nz;
                    x[3 * nodes + 1] = (j + 0.5 * centre) / nz;
                    x[3 * nodes + 2] = (k + 0.5 * centre) / nz;
                }
    for (axis = 0; axis < 3; ++axis)
        for (i = 0; i <= nx; ++i)
            for (j = 0; j <= ny; ++j)
                for (k = 0; k <= nz; ++k) {
                    static const int corner[4][2] = {{0, 0}, {1, 0}, {1, 1}, {0, 1}};
                    const int at[3] = {i, j, k}, b = (axis + 1) % 3, c = (axis + 2) % 3, turn = (i + j + k) % 2;
                    sfem_int face[4], side[2] = {-1, -1};
                    if (at[b] == n[b] || at[c] == n[c]) continue;
                    for (s = 0; s < 4; ++s) {
                        int to[3] = {i, j, k};
                        to[b] += corner[s][0];
                        to[c] += corner[s][1];
                        face[s] = (to[0] * (ny + 1) + to[1]) * (nz + 1) + to[2];
                    }
                    for (s = 0; s < 2; ++s) {
                        int to[3] = {i, j, k};
                        to[axis] -= 1 - s;
                        if (to[axis] >= 0 && to[axis] < n[axis])
                            side[s] = corners + (to[0] * ny + to[1]) * nz + to[2];
                    }
                    for (s = 0; s < 4; ++s) {
                        sfem_int *t = tet + 4 * tets;
                        if (side[0] < 0 || side[1] < 0) {
                            if (s > 1) break;
                            t[0] = side[0] < 0 ? side[1] : side[0];
                            t[1] = face[turn];
                            t[2] = face[(turn + 1 + s) % 4];
                            t[3] = face[(turn + 2 + s) % 4];
                        } else {
                            t[0] = side[0], t[1] = side[1], t[2] = face[s], t[3] = face[(s + 1) % 4];
                        }
                        ++tets;
                    }
                }
    for (i = 0; i < tets; ++i)
        if (body_quality(x, tet + 4 * i) < 0) {
            const sfem_int first = tet[4 * i];
            tet[4 * i] = tet[4 * i + 1];
            tet[4 * i + 1] = first;
        }
    status = sfem_mesh_copy(nodes, x, tets, tet, NULL, out, err);
    free(x);
    free(tet);
    return status;
}

/* The Delaunay tets of a grid whose points are moved by up to a third of a cell, inside and along the surface. */
BODY_STATIC sfem_status strip_delaunay(int nx, int ny, int nz, uint64_t seed, sfem_mesh *out, sfem_error *err)
{
    const int n[3] = {nx, ny, nz};
    const double step = 12000.0 * nz / nx; /* of the whole numbers in a cell's height times nz */
    body_points p;
    body_random r;
    double *x;
    sfem_int *tet;
    sfem_int tets = 0;
    sfem_status status;
    int *found, count, i, j, k, c;
    memset(&p, 0, sizeof p);
    r.state = seed;
    p.grid = (int64_t(*)[3])body_new((size_t)((nx + 1) * (ny + 1) * (nz + 1)), sizeof *p.grid);
    for (i = 0; i <= nx; ++i)
        for (j = 0; j <= ny; ++j)
            for (k = 0; k <= nz; ++k, ++p.n) {
                const int at[3] = {i, j, k};
                for (c = 0; c < 3; ++c) {
                    const double by = body_uniform(&r, -0.33, 0.33) * (at[c] > 0 && at[c] < n[c]);
                    p.grid[p.n][c] = (int64_t)floor((at[c] + by - 0.5 * n[c]) / nz * step + 0.5);
                }
            }
    count = body_connect(&p, &found);
    x = (double *)body_new(3 * (size_t)p.n, sizeof *x);
    tet = (sfem_int *)body_new(4 * (size_t)count, sizeof *tet);
    for (i = 0; i < 3 * p.n; ++i) {
        x[i] = (double)p.grid[i / 3][i % 3] / step + 0.5 * n[i % 3] / nz;
        if (p.grid[i / 3][i % 3] == (int64_t)floor(0.5 * n[i % 3] / nz * step + 0.5)) x[i] = (double)n[i % 3] / nz;
        if (p.grid[i / 3][i % 3] == (int64_t)floor(-0.5 * n[i % 3] / nz * step + 0.5)) x[i] = 0;
    }
    for (i = 0; i < count; ++i) {
        for (c = 0; c < 4; ++c) tet[4 * tets + c] = found[4 * i + c];
        tets += body_quality(x, tet + 4 * tets) > 1e-3; /* flat ones lie in the surface */
    }
    status = sfem_mesh_copy(p.n, x, tets, tet, NULL, out, err);
    free(p.grid);
    free(found);
    free(x);
    free(tet);
    return status;
}

/* A block of nx x ny x nz cells, nz of them 1 m. */
BODY_STATIC sfem_status strip_block(int kind, const int n[3], uint64_t seed, sfem_mesh *out, sfem_error *err)
{
    const double size[3] = {(double)n[0] / n[2], (double)n[1] / n[2], 1};
    sfem_int cells[3];
    cells[0] = n[0], cells[1] = n[1], cells[2] = n[2];
    if (kind == STRIP_CENTRED) return strip_centred(n[0], n[1], n[2], out, err);
    if (kind == STRIP_DELAUNAY) return strip_delaunay(n[0], n[1], n[2], seed, out, err);
    return sfem_mesh_block(cells, size, kind == STRIP_5_TETS ? SFEM_CELL_5_TETS : SFEM_CELL_6_TETS, NULL, out, err);
}

/* The tets of a larger block, rotated about y by so many degrees, all of whose nodes are in the strip. Its rim is ragged. */
BODY_STATIC sfem_status strip_rotated(int kind, int n, int thick, uint64_t seed, double degrees, sfem_mesh *out,
                                      sfem_error *err)
{
    const double angle = degrees * 3.14159265358979323846 / 180, c = cos(angle), s = sin(angle);
    const int half[2] = {(int)ceil(n * (1.5 * fabs(c) + 0.5 * fabs(s))) + 1, (int)ceil(n * (1.5 * fabs(s) + 0.5 * fabs(c))) + 1};
    const int cells[3] = {2 * half[0], thick, 2 * half[1]};
    sfem_int *index, *tet, tets = 0, nodes = 0, i;
    sfem_status status;
    sfem_mesh all;
    double *x;
    int k;
    status = strip_block(kind, cells, seed, &all, err);
    if (status != SFEM_OK) return status;
    x = (double *)body_new(3 * (size_t)all.nodes, sizeof *x);
    tet = (sfem_int *)body_new(4 * (size_t)all.tets, sizeof *tet);
    index = (sfem_int *)body_new((size_t)all.nodes, sizeof *index);
    for (i = 0; i < all.nodes; ++i) {
        double *to = all.x + 3 * (size_t)i;
        const double scale = (double)cells[2] / n, a = scale * to[0] - (double)half[0] / n, b = scale * to[2] - (double)half[1] / n;
        to[0] = c * a - s * b + 1.5;
        to[1] *= scale;
        to[2] = s * a + c * b + 0.5;
        index[i] = to[0] >= 0 && to[0] <= STRIP_LENGTH && to[2] >= 0 && to[2] <= 1 ? -1 : -2;
    }
    for (i = 0; i < all.tets; ++i) {
        const sfem_int *t = all.tet + 4 * (size_t)i;
        if (index[t[0]] < -1 || index[t[1]] < -1 || index[t[2]] < -1 || index[t[3]] < -1) continue;
        for (k = 0; k < 4; ++k) {
            if (index[t[k]] < 0) {
                index[t[k]] = nodes;
                memcpy(x + 3 * (size_t)nodes++, all.x + 3 * (size_t)t[k], 3 * sizeof *x);
            }
            tet[4 * (size_t)tets + (size_t)k] = index[t[k]];
        }
        ++tets;
    }
    status = sfem_mesh_copy(nodes, x, tets, tet, NULL, out, err);
    sfem_mesh_free(&all);
    free(index);
    free(tet);
    free(x);
    return status;
}

BODY_STATIC sfem_status strip_mesh(int kind, int n, int thick, uint64_t seed, sfem_mesh *out, sfem_error *err)
{
    const int cells[3] = {3 * n, thick, n};
    return strip_block(kind, cells, seed, out, err);
}

typedef struct strip {
    int kind, n, thick;
    uint64_t seed;
    sfem_law law;
    double poisson;
    double per_cell;        /* time steps in which a wave of speed sqrt(E/rho) crosses a cell: 2 */
    double until;           /* of Griffith's displacement, at the end */
    double rotate;          /* the mesh about y, degrees; 0: cells along the strip. Else grips are 1.2 cells high */
    sfem_damage_def damage; /* toughness is set to 1 J/m^2; strengths are strains over Griffith's mean one */
} strip;

typedef struct strip_result {
    double griffith;        /* displacement of top and bottom, m */
    double first, peak;     /* displacement over it at the first break and at the largest force */
    double parted;          /* where top and bottom are no longer one piece, 0: never */
    int pieces, crumbs;     /* at the end; those of one node */
    int halves;             /* those of a tenth of the nodes or more */
    double error;           /* of the energies */
    /* the path of the crack over the 1.2 m ahead of the blade, by edges weighted by dual areas: */
    double angle, rough;    /* its mean direction, degrees; the RMS distance from that line, in cells */
    double area;            /* 2/3 of the dual areas over the section */
} strip_result;

BODY_STATIC void strip_must(sfem_status status, const sfem_error *err)
{
    if (status == SFEM_OK) return;
    fprintf(stderr, "strip.h: %s\n", err->text);
    exit(2);
}

/* 10^6 Pa, 1000 kg/m^3: waves of some 32 m/s; the lowest swing is damped well. */
BODY_STATIC sfem_model *strip_model(const strip *s, const sfem_mesh *mesh)
{
    sfem_model_def def = sfem_default_model_def();
    sfem_model *model = NULL;
    sfem_error err;
    def.mesh = mesh;
    def.material.law = s->law;
    def.material.young = 1e6;
    def.material.poisson = s->poisson;
    def.material.density = 1000;
    def.material.mass_damping = 60;
    strip_must(sfem_model_create(&def, &model, &err), &err);
    return model;
}

/* -1 at the bottom, 1 at the top */
BODY_STATIC int strip_end(const strip *s, const sfem_mesh *mesh, sfem_int node)
{
    const double z = mesh->x[3 * (size_t)node + 2], grip = s->rotate != 0 ? 1.2 / s->n : 1e-9;
    return z < grip ? -1 : z > 1 - grip ? 1 : 0;
}

BODY_STATIC void strip_move(const strip *s, sfem_body *body, const sfem_mesh *mesh, double way)
{
    sfem_error err;
    sfem_int i;
    for (i = 0; i < mesh->nodes; ++i) {
        double to[3];
        if (!strip_end(s, mesh, i)) continue;
        memcpy(to, mesh->x + 3 * (size_t)i, sizeof to);
        to[2] += way * strip_end(s, mesh, i);
        strip_must(sfem_body_move_pin(body, i, to, &err), &err);
    }
}

/* Where W H = 1 J/m^2, by the stresses of the whole strip at rest, in the middle of its length. */
BODY_STATIC double strip_griffith(const strip *s, const sfem_mesh *mesh, const sfem_body_def *held)
{
    const double way = 1e-4, nu = s->poisson;
    strip soft = *s;
    sfem_model *model;
    sfem_body *body;
    double *stress = (double *)body_new(6 * (size_t)mesh->tets, sizeof *stress), energy = 0;
    sfem_error err;
    sfem_int e;
    int k;
    soft.law = SFEM_LINEAR;
    model = strip_model(&soft, mesh);
    strip_must(sfem_body_create(model, held, &body, &err), &err);
    strip_move(s, body, mesh, way);
    strip_must(sfem_body_solve_static(body, &err), &err);
    sfem_model_stress(model, sfem_body_displacement(body), stress, NULL);
    for (e = 0; e < mesh->tets; ++e) {
        const sfem_int *t = mesh->tet + 4 * (size_t)e;
        const double *p = stress + 6 * (size_t)e, *x[4];
        double d[9], v, square = 0, middle = 0;
        for (k = 0; k < 4; ++k) {
            x[k] = mesh->x + 3 * (size_t)t[k];
            middle += x[k][0] / 4;
        }
        if (fabs(middle - 1.6) > 0.3) continue;
        for (k = 0; k < 9; ++k) d[k] = x[k / 3 + 1][k % 3] - x[0][k % 3];
        v = (d[0] * (d[4] * d[8] - d[5] * d[7]) - d[1] * (d[3] * d[8] - d[5] * d[6]) +
             d[2] * (d[3] * d[7] - d[4] * d[6])) / 6;
        for (k = 0; k < 6; ++k) square += (k < 3 ? 1 : 2) * p[k] * p[k];
        energy += v * ((1 + nu) * square - nu * (p[0] + p[1] + p[2]) * (p[0] + p[1] + p[2])) / 2e6;
            }
    sfem_body_free(body);
    sfem_model_free(model);
    free(stress);
    return way / sqrt(energy / (0.6 * s->thick / s->n));
}

/* How many tenths of a body its pieces are. */
BODY_STATIC void strip_count(sfem_body *body, sfem_int nodes, strip_result *r)
{
    const int count = (int)sfem_body_fracture(body).pieces;
    sfem_piece *piece = (sfem_piece *)body_new((size_t)count, sizeof *piece);
    int i;
    sfem_body_pieces(body, piece);
    for (i = r->halves = r->crumbs = 0; i < count; ++i) {
        r->halves += piece[i].nodes >= nodes / 10;
        r->crumbs += piece[i].nodes == 1;
    }
    r->pieces = count;
    free(piece);
}

/* Is the top in another piece than the bottom? */
BODY_STATIC int strip_parted(const strip *s, sfem_body *body, const sfem_mesh *mesh)
{
    const sfem_int *of = sfem_body_piece_of(body);
    sfem_int i, end[2] = {-1, -1};
    for (i = 0; i < mesh->nodes; ++i)
        if (strip_end(s, mesh, i)) end[strip_end(s, mesh, i) > 0] = of[i];
    return end[0] != end[1];
}

/* The force at the top, N. */
BODY_STATIC double strip_force(const strip *s, sfem_body *body, const sfem_mesh *mesh, double *reactions)
{
    double sum = 0;
    sfem_int i;
    memset(reactions, 0, 3 * (size_t)mesh->nodes * sizeof *reactions);
    sfem_body_reactions(body, reactions);
    for (i = 0; i < mesh->nodes; ++i)
        if (strip_end(s, mesh, i) > 0) sum += reactions[3 * i + 2];
    return sum;
}

/* The cracked strip, held; tets at the clamps do not break, so that grips do not decide. */
BODY_STATIC sfem_body *strip_body(strip *s, const sfem_mesh *mesh, sfem_model *model, const sfem_body_def *held,
                                  double griffith)
{
    const double height = s->rotate != 0 ? 0.5003
                          : s->kind == STRIP_CENTRED   ? 0.5 + 0.25 / s->n
                          : s->kind == STRIP_DELAUNAY ? 0.5
                                                      : 0.5 + 0.5 / s->n * (s->n % 2 == 0);
    double from[9] = {STRIP_CRACK, -9, 0, STRIP_CRACK, 9, 0, -9, 0, 0}, to[9];
    unsigned char *grip = (unsigned char *)body_new((size_t)mesh->tets, 1);
    sfem_body_def def = *held;
    sfem_damage_def damage = s->damage;
    sfem_body *body = NULL;
    sfem_error err;
    sfem_int k;
    for (k = 0; k < 4 * mesh->tets; ++k) grip[k / 4] |= strip_end(s, mesh, mesh->tet[k]) != 0;
    damage.unbreakable = grip;
    damage.toughness = 1;
    damage.strength *= 2 * griffith * (damage.criterion == SFEM_BREAK_STRESS ? 1e6 : 1);
    damage.soften[0] *= 2 * griffith;
    damage.soften[1] *= 2 * griffith;
    def.damage = &damage;
    strip_must(sfem_body_create(model, &def, &body, &err), &err);
    memcpy(to, from, sizeof to);
    for (k = 2; k < 9; k += 3) from[k] = height - 1e-5, to[k] = height + 1e-5;
    strip_must(sfem_body_cut(body, from, to, NULL, &err), &err);
    free(grip);
    return body;
}

/* Where it broke. */
typedef struct strip_path {
    int count;
    double weight, x, z, xx, xz, zz;
} strip_path;

BODY_STATIC void strip_follow(const sfem_body *body, strip_path *p)
{
    sfem_int count, k;
    const sfem_break *b = sfem_body_breaks(body, &count);
    for (k = 0; k < count; ++k) {
        const double x = b[k].x[0] - STRIP_CRACK - 0.6, z = b[k].x[2] - 0.5, w = b[k].area;
        if (fabs(x) > 0.6 || b[k].reason == SFEM_BROKE_BLADE) continue;
        p->weight += w, p->x += w * x, p->z += w * z, p->xx += w * x * x, p->xz += w * x * z, p->zz += w * z * z;
        ++p->count;
    }
}

BODY_STATIC void strip_path_of(const strip *s, const strip_path *p, strip_result *r)
{
    const double w = p->weight, xx = p->xx - p->x * p->x / w, xz = p->xz - p->x * p->z / w, zz = p->zz - p->z * p->z / w;
    if (p->count < 3) return;
    r->angle = atan2(xz, xx) * 180 / 3.14159265358979323846;
    r->rough = sqrt(fmax(zz - xz * xz / xx, 0.0) / w) * s->n;
    r->area = w / 1.5 / (1.2 * s->thick / s->n);
}

/* At the speed at which Griffith's displacement takes 0.6 s, 19 crossings of the height by a wave. */
BODY_STATIC void strip_pull(strip *s, strip_result *r)
{
    sfem_body_def held = sfem_default_body_def();
    const double h = 1 / (s->n * s->per_cell * sqrt(1000.0));
    double *reactions, most = 0;
    sfem_int *pins, i;
    sfem_model *model;
    sfem_body *body;
    sfem_mesh mesh;
    sfem_error err;
    strip_path path;
    int k, cut = 0;
    memset(r, 0, sizeof *r);
    memset(&path, 0, sizeof path);
    strip_must(s->rotate != 0 ? strip_rotated(s->kind, s->n, s->thick, s->seed, s->rotate, &mesh, &err)
                              : strip_mesh(s->kind, s->n, s->thick, s->seed, &mesh, &err), &err);
    reactions = (double *)body_new(3 * (size_t)mesh.nodes, sizeof *reactions);
    held.pins = pins = (sfem_int *)body_new((size_t)mesh.nodes, sizeof *pins);
    for (i = 0; i < mesh.nodes; ++i)
        if (strip_end(s, &mesh, i)) pins[held.pin_count++] = i;
    r->griffith = strip_griffith(s, &mesh, &held);
    model = strip_model(s, &mesh);
    body = strip_body(s, &mesh, model, &held, r->griffith);
    for (k = 1; r->parted == 0 && h * k / 0.6 < s->until; ++k) {
        const double way = h * k / 0.6;
        double force;
        strip_move(s, body, &mesh, way * r->griffith);
        strip_must(sfem_body_step(body, h, &err), &err);
        strip_follow(body, &path);
        force = strip_force(s, body, &mesh, reactions);
        if (k == 4) cut = (int)sfem_body_fracture(body).broken;
        if (k > 4 && r->first == 0 && sfem_body_fracture(body).broken > cut) r->first = way;
        if (force > most) most = force, r->peak = way;
        if (strip_parted(s, body, &mesh)) r->parted = way;
    }
    r->error = fabs(sfem_body_fracture(body).error) / sfem_body_fracture(body).scale;
    strip_count(body, mesh.nodes, r);
    strip_path_of(s, &path, r);
    sfem_body_free(body);
    sfem_model_free(model);
    sfem_mesh_free(&mesh);
    free(pins);
    free(reactions);
}

BODY_STATIC strip strip_default(int kind, int n)
{
    strip s;
    memset(&s, 0, sizeof s);
    s.kind = kind;
    s.n = n;
    s.thick = 1;
    s.seed = 1;
    s.law = SFEM_LINEAR;
    s.poisson = 0.3;
    s.per_cell = 2;
    s.until = 1.6;
    s.damage = sfem_default_damage_def();
    return s;
}

#endif
