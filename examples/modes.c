/* modes - the lowest modes of a body: frequencies, errors, shapes.
 *
 *     //|==========      modes                                  a clamped bar, made here
 *        )  (  ) (       modes body.msh --free --modes 12       a file's body, held by nothing
 *
 * K phi = lambda M phi, f = sqrt(lambda) / 2 pi, by block Lanczos with a count that proves that none is
 * missing [softfem.h, >>api-modes]. Prints `mode K HZ ERROR`, and leaves a contact sheet of the shapes in
 * the --out directory, with --vtu also modes.vtu for ParaView.
 *
 *     cc -O2 -c -DSOFTFEM_IMPLEMENTATION -x c softfem.h && cc -O2 -I. examples/modes.c softfem.o -lm
 */
#include "support.h"
#include "softfem.h"

static const ex_option table[] = {
    {"MESH", "FILE", NULL,
     ".msh, .vtk, .mesh, .veg, .node or .ele; without it a bar of 4 x 1 x 1 m"},
    {"--modes", "N", "12", "how many"},
    {"--below", "HZ", "0", "instead, all below this frequency"},
    {"--young", "E", "1e6", "Young's modulus, Pa"},
    {"--poisson", "NU", "0.3", "Poisson's ratio"},
    {"--density", "RHO", "1000", "kg/m^3"},
    {"--mass", "lumped|consistent", "consistent", "mass matrix"},
    {"--fix", "WHERE", "x<0.01", "nodes held"},
    {"--free", NULL, NULL, "nothing held; rigid modes are left out"},
    {"--cells", "NX,NY,NZ", "24,6,6", "cells of the bar, five tets each"},
    {"--threads", "N", "1", "threads"},
    {"--out", "DIR", "build/modes", "where files go"},
    {"--vtu", NULL, NULL, "write modes.vtu, a field for each mode"},
    {"--quick", NULL, NULL, "a small run: a coarse bar"},
    {NULL, NULL, NULL, NULL}};

typedef struct run {
    ex_options o;
    sfem_mesh mesh;
    sfem_surface surface;
    sfem_modes modes;
    double lower[3], upper[3]; /* of the body at rest */
} run;

static void must(sfem_status status, const sfem_error *err)
{
    if (status != SFEM_OK) ex_fail("%s", err->text);
}

/* 1. The body. */
static void read_mesh(run *r)
{
    const char *path = ex_text(&r->o, "MESH");
    sfem_error err;
    double cells[3];
    sfem_int n[3];
    int k;
    ex_reals(&r->o, "--cells", 3, cells);
    if (path) {
        must(sfem_mesh_read(path, NULL, &r->mesh, &err), &err);
        sfem_mesh_orient(&r->mesh);
    } else {
        const sfem_real size[3] = {4, 1, 1};
        for (k = 0; k < 3; ++k)
            n[k] = (sfem_int)(ex_given(&r->o, "--quick") ? (k ? 2 : 8) : cells[k]);
        must(sfem_mesh_block(n, size, SFEM_CELL_5_TETS, NULL, &r->mesh, &err), &err);
    }
    must(sfem_mesh_surface(&r->mesh, NULL, &r->surface, &err), &err);
    ex_bounds(r->mesh.x, r->mesh.nodes, 1, r->lower, r->upper);
}

/* 2. Its modes. */
static void solve(run *r)
{
    sfem_model_def model_def = sfem_default_model_def();
    sfem_modes_def def = sfem_default_modes_def();
    sfem_int *pins = (sfem_int *)ex_new((size_t)r->mesh.nodes, sizeof *pins), i;
    sfem_model *model;
    sfem_error err;
    model_def.mesh = &r->mesh;
    model_def.material.young = ex_real(&r->o, "--young");
    model_def.material.poisson = ex_real(&r->o, "--poisson");
    model_def.material.density = ex_real(&r->o, "--density");
    model_def.mass = ex_choice(&r->o, "--mass") ? SFEM_MASS_CONSISTENT : SFEM_MASS_LUMPED;
    must(sfem_model_create(&model_def, &model, &err), &err);
    if (!ex_given(&r->o, "--free")) {
        const ex_selection where = ex_selection_of(ex_text(&r->o, "--fix"));
        for (i = 0; i < r->mesh.nodes; ++i)
            if (ex_selected(&where, i, r->mesh.x + 3 * (size_t)i)) pins[def.pin_count++] = i;
        if (def.pin_count == 0)
            ex_fail("--fix %s selects no node; --free?", ex_text(&r->o, "--fix"));
    }
    def.pins = pins;
    def.modes = (sfem_int)ex_integer(&r->o, "--modes");
    def.below_hz = ex_real(&r->o, "--below");
    def.exec.threads = (sfem_int)ex_count(&r->o, "--threads", 1);
    must(sfem_modes_create(model, &def, &r->modes, &err), &err);
    sfem_model_free(model);
    free(pins);
}

/* The body bent by mode k, its largest displacement a seventh of the body's diagonal; size [nodes] is
 * the displacement's length, 1 at most. */
static void bend(const run *r, sfem_int k, double *x, double *size)
{
    const double *phi = r->modes.phi + (size_t)k * 3 * (size_t)r->mesh.nodes;
    double d[3], most = 0, scale;
    sfem_int i;
    int c;
    for (c = 0; c < 3; ++c) d[c] = r->upper[c] - r->lower[c];
    for (i = 0; i < r->mesh.nodes; ++i) {
        const double *u = phi + 3 * (size_t)i;
        size[i] = sqrt(ex_dot(u, u));
        most = fmax(most, size[i]);
    }
    scale = most > 0 ? sqrt(ex_dot(d, d)) / 7 / most : 0;
    for (i = 0; i < r->mesh.nodes; ++i) {
        for (c = 0; c < 3; ++c)
            x[3 * (size_t)i + (size_t)c] =
                r->mesh.x[3 * (size_t)i + (size_t)c] + scale * phi[3 * (size_t)i + (size_t)c];
        if (most > 0) size[i] /= most;
    }
}

/* 3. A picture: up to 24 shapes, coloured by how far they move. */
static void draw(const run *r)
{
    static const double direction[3] = {-0.5, -1, 0.55};
    const sfem_int count = r->modes.count < 24 ? r->modes.count : 24;
    const int across = count > 12 ? 6 : count > 6 ? 4 : count > 4 ? 3 : 2;
    const int down = (int)((count + across - 1) / across);
    double *x = (double *)ex_new(3 * (size_t)r->mesh.nodes, sizeof *x), lower[3], upper[3];
    double *size = (double *)ex_new((size_t)r->mesh.nodes, sizeof *size);
    ex_style style = ex_default_style();
    ex_picture *p;
    sfem_int k;
    int c;
    char caption[64];
    if (count == 0) return;
    p = ex_picture_new(400 * across, 300 * down);
    p->ground = NAN;
    for (c = 0; c < 3; ++c) {
        const double room = 0.09 * (r->upper[0] - r->lower[0] + r->upper[1] - r->lower[1] +
                                    r->upper[2] - r->lower[2]);
        lower[c] = r->lower[c] - (c == 0 ? 0.3 : 0.8) * room;
        upper[c] = r->upper[c] + (c == 0 ? 0.3 : 0.8) * room;
    }
    style.edges = r->mesh.tets > 20000 ? 0 : 0.25;
    for (k = 0; k < count; ++k) {
        ex_progress("drawing", k, count);
        bend(r, k, x, size);
        ex_view_begin(p, (int)k, across, down, lower, upper, direction);
        ex_view_surface(p, r->mesh.nodes, x, r->surface.triangles, r->surface.tri, size, &style);
        snprintf(caption, sizeof caption, "%d: %.4g Hz", (int)k + 1, sfem_modes_hz(&r->modes, k));
        ex_view_end(p, caption);
    }
    ex_progress("drawing", count, count);
    ex_picture_write(p, ex_path(ex_text(&r->o, "--out"), "modes.png"));
    ex_picture_free(p);
    free(x);
    free(size);
    printf("wrote %s/modes.png\n", ex_text(&r->o, "--out"));
}

static void write_vtu(const run *r)
{
    sfem_field *field = (sfem_field *)ex_new((size_t)r->modes.count, sizeof *field);
    char(*name)[32] = (char(*)[32])ex_new((size_t)r->modes.count, sizeof *name);
    sfem_error err;
    sfem_int k;
    for (k = 0; k < r->modes.count; ++k) {
        snprintf(name[k], sizeof name[k], "mode %d", (int)k + 1);
        field[k].name = name[k];
        field[k].values = r->modes.phi + (size_t)k * 3 * (size_t)r->mesh.nodes;
        field[k].components = 3;
    }
    must(sfem_mesh_write_vtu(ex_path(ex_text(&r->o, "--out"), "modes.vtu"), &r->mesh, NULL, field,
                        r->modes.count, &err),
         &err);
    free(field);
    free(name);
    printf("wrote %s/modes.vtu\n", ex_text(&r->o, "--out"));
}

int main(int argc, char **argv)
{
    double start;
    sfem_int k;
    run r;
    memset(&r, 0, sizeof r);
    r.o = ex_parse(argc, argv, "The lowest modes of an elastic body.", table);
    read_mesh(&r);
    start = ex_seconds();
    solve(&r);
    start = ex_seconds() - start;
    ex_make_directory(ex_text(&r.o, "--out"));
    draw(&r);
    if (ex_given(&r.o, "--vtu")) write_vtu(&r);
    for (k = 0; k < r.modes.count; ++k)
        printf("mode %d %.15g %.3g\n", (int)k + 1, sfem_modes_hz(&r.modes, k), r.modes.error[k]);
    printf("nodes %d\ntets %d\nmodes %d\nseconds %.3f\nsolves %d\nproved %d\n", (int)r.mesh.nodes,
           (int)r.mesh.tets, (int)r.modes.count, start, (int)r.modes.info.solves,
           r.modes.info.verified);
    if (r.modes.info.cut > 0) printf("more copies of the last mode: %d\n", (int)r.modes.info.cut);
    sfem_modes_free(&r.modes);
    sfem_surface_free(&r.surface);
    sfem_mesh_free(&r.mesh);
    return 0;
}
