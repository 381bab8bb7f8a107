/* tetrahedralize - any closed surface, or what nearly is one, as tetrahedra.
 *
 *       ____                       ____
 *      /    \___                  /\/\/\___
 *      \____    \    ------->     \/\/\/\/\|      the lattice cut along the surface, or
 *           \___/                      \/\/       with --cage every lattice tet that meets it
 *
 *     tetrahedralize body.obj body.msh --tets 20000
 *     tetrahedralize body.stl body.vtu --size 0.05 --cage
 *     tetrahedralize                      a torus of its own
 *     tetrahedralize body.inp body.vtu    a file that has tets already: they are written in the other format
 *
 * Build: cc -std=c99 -O2 -DSOFTFEM_IMPLEMENTATION -x c softfem.h -x c examples/tetrahedralize.c -I. -lm
 * Reads .obj, .stl, .ply, .off and what sfem_mesh_read does; writes .msh, .vtu or .veg, by the name. Leaves a picture of
 * the tets on one side of a cut in the --out directory. Prints `key value` lines: what was mended in the surface, tets,
 * nodes, quality, angles, volume, seconds.
 */
#include "support.h"
#include "picture.h"
#include "softfem.h"

static const ex_option table[] = {
    {"IN", "IN", NULL,
     "a surface: .obj, .stl, .ply, .off, or the triangles of a mesh file; one with tets, and no --tets, --size or --cage, is only "
     "written in the other format; without IN a torus"},
    {"OUTPUT", "OUTPUT", NULL, "tets: .msh, .vtu or .veg, with the numbers of regions, in .veg without; else mesh.msh in the --out directory"},
    {"--tets", "N", "5000", "how many, within 15 percent"},
    {"--size", "H", NULL, "or the longer edges of the lattice, m"},
    {"--linear", NULL, NULL, "10-node tets of a file become 4-node ones"},
    {"--cage", NULL, NULL, "whole tets that contain the surface, instead of tets that are cut along it"},
    {"--threads", "N", "1", "threads"},
    {"--out", "DIR", "build/tetrahedralize", "where the picture goes"},
    {"--quick", NULL, NULL, "a small run: 1000 tets"},
    {NULL, NULL, NULL, NULL}};

static void must(sfem_status status, const sfem_error *err)
{
    if (status != SFEM_OK) ex_fail("%s", err->text);
}

/* 1. The surface: from a file, or a torus. */
static sfem_surface torus(void)
{
    enum { N = 64, M = 24 };
    static double x[N * M][3];
    static sfem_int tri[2 * N * M][3];
    sfem_surface s;
    int i, j;
    memset(&s, 0, sizeof s);
    for (i = 0; i < N; ++i)
        for (j = 0; j < M; ++j) {
            const double u = 6.283185307179586 * i / N, v = 6.283185307179586 * j / M;
            const sfem_int a = i * M + j, b = (i + 1) % N * M + j, c = (i + 1) % N * M + (j + 1) % M, d = i * M + (j + 1) % M;
            x[a][0] = (1 + 0.4 * cos(v)) * cos(u), x[a][1] = (1 + 0.4 * cos(v)) * sin(u), x[a][2] = 0.4 * sin(v);
            tri[2 * a][0] = a, tri[2 * a][1] = b, tri[2 * a][2] = c;
            tri[2 * a + 1][0] = a, tri[2 * a + 1][1] = c, tri[2 * a + 1][2] = d;
        }
    s.nodes = N * M;
    s.triangles = 2 * N * M;
    s.x = x[0];
    s.tri = tri[0];
    return s;
}

/* 2. Writing, by the name. */
static void write_veg(const char *path, const sfem_mesh *m)
{
    FILE *f = ex_open(path);
    sfem_int i;
    fprintf(f, "# softfem\n*VERTICES\n%ld 3 0 0\n", (long)m->nodes);
    for (i = 0; i < m->nodes; ++i)
        fprintf(f, "%ld %.17g %.17g %.17g\n", (long)i + 1, m->x[3 * i], m->x[3 * i + 1], m->x[3 * i + 2]);
    fprintf(f, "*ELEMENTS\nTET\n%ld 4 0\n", (long)m->tets);
    for (i = 0; i < m->tets; ++i)
        fprintf(f, "%ld %ld %ld %ld %ld\n", (long)i + 1, (long)m->tet[4 * i] + 1, (long)m->tet[4 * i + 1] + 1,
                (long)m->tet[4 * i + 2] + 1, (long)m->tet[4 * i + 3] + 1);
    ex_close(f, path);
}

static void write_mesh(const char *path, const sfem_mesh *m)
{
    const char *tail = strrchr(path, '.');
    sfem_error err;
    if (!strcmp(tail, ".vtu"))
        must(sfem_mesh_write_vtu(path, m, NULL, NULL, 0, &err), &err);
    else if (!strcmp(tail, ".veg"))
        write_veg(path, m);
    else
        must(sfem_mesh_write_msh(path, m, &err), &err);
}

/* Before the work begins. */
static void check_name(const char *path)
{
    const char *tail = strrchr(path, '.');
    FILE *file;
    if (!tail || (strcmp(tail, ".vtu") != 0 && strcmp(tail, ".veg") != 0 && strcmp(tail, ".msh") != 0))
        ex_fail("%s: the name has to end in .msh, .vtu or .veg", path);
    file = fopen(path, "ab"); /* what is there stays for now: it may be the input */
    if (!file) ex_fail("%s: %s", path, strerror(errno));
    ex_close(file, path);
}

/* 3. The picture: tets behind the middle of the longest axis but one, their faces that the cut laid open in orange. */
static void draw(const sfem_mesh *m, const char *path)
{
    static const double outer[3] = {0.50, 0.62, 0.74}, inner[3] = {0.93, 0.60, 0.34};
    const double from[3] = {0.45, -1, 0.55};
    double lower[3], upper[3], middle;
    ex_picture *p = ex_picture_new(1200, 900);
    ex_style style = ex_default_style();
    sfem_surface whole, half;
    sfem_mesh part = *m;
    sfem_error err;
    int32_t *tri[2];
    long count[2] = {0, 0};
    unsigned char *skin = (unsigned char *)ex_new((size_t)m->nodes, 1);
    sfem_int t;
    int k, c;
    ex_bounds(m->x, m->nodes, 1, lower, upper);
    middle = 0.5 * (lower[1] + upper[1]);
    part.tet = (sfem_int *)ex_new(4 * (size_t)m->tets, sizeof *part.tet);
    part.tets = 0;
    for (t = 0; t < m->tets; ++t) {
        double y = 0;
        for (k = 0; k < 4; ++k) y += 0.25 * m->x[3 * m->tet[4 * t + k] + 1];
        if (y < middle) continue;
        memcpy(part.tet + 4 * part.tets++, m->tet + 4 * t, 4 * sizeof *part.tet);
    }
    must(sfem_mesh_surface(m, NULL, &whole, &err), &err);
    must(sfem_mesh_surface(&part, NULL, &half, &err), &err);
    for (t = 0; t < 3 * whole.triangles; ++t) skin[whole.tri[t]] = 1;
    for (k = 0; k < 2; ++k) tri[k] = (int32_t *)ex_new(3 * (size_t)half.triangles + 1, sizeof **tri);
    for (t = 0; t < half.triangles; ++t) {
        const sfem_int *v = half.tri + 3 * t;
        k = !(skin[v[0]] && skin[v[1]] && skin[v[2]]);
        for (c = 0; c < 3; ++c) tri[k][3 * count[k] + c] = v[c];
        ++count[k];
    }
    ex_view_begin(p, 0, 1, 1, lower, upper, from);
    style.flat = 1;
    style.edges = 0.6;
    for (k = 0; k < 2; ++k) {
        memcpy(style.color, k ? inner : outer, sizeof style.color);
        ex_view_surface(p, m->nodes, m->x, count[k], tri[k], NULL, &style);
        free(tri[k]);
    }
    ex_view_end(p, "cut in the middle");
    ex_picture_write(p, path);
    ex_picture_free(p);
    sfem_surface_free(&whole);
    sfem_surface_free(&half);
    free(part.tet);
    free(skin);
}

static void print_mesh(const sfem_mesh *m)
{
    sfem_mesh_report report;
    sfem_error err;
    must(sfem_mesh_check(m, &report, &err), &err);
    printf("tets         %ld\nnodes        %ld\ncomponents   %ld\n", (long)m->tets, (long)m->nodes, (long)report.components);
    printf("min_quality  %.3f\nmean_quality %.3f\n", report.min_quality, report.mean_quality);
}

/* 4. Tets that fill the surface. */
static void show_progress(sfem_real part, void *user)
{
    (void)user;
    ex_progress("tetrahedralize", (long)(1000 * part), 1000);
}

static sfem_mesh fill(const ex_options *o, const sfem_surface *surface)
{
    sfem_mesher_def def = sfem_default_mesher_def();
    sfem_mesher_info info;
    sfem_mesh mesh;
    sfem_error err;
    double begin;
    def.mode = ex_given(o, "--cage") ? SFEM_CAGE : SFEM_FITTED;
    def.tets = (sfem_int)ex_integer(o, "--tets");
    if (ex_given(o, "--quick") && !ex_given(o, "--tets")) def.tets = 1000;
    if (ex_given(o, "--size")) def.size = ex_positive(o, "--size");
    def.exec.threads = (sfem_int)ex_count(o, "--threads", 1);
    def.progress = show_progress;
    show_progress(0, NULL); /* the clock starts */
    begin = ex_seconds();
    must(sfem_mesh_from_surface(&def, surface, &mesh, &info, &err), &err);
    begin = ex_seconds() - begin;
    printf("triangles    %ld (left out: %ld without area, %ld doubled; reversed: %ld; open edges: %ld)\n",
           (long)surface->triangles, (long)info.degenerate, (long)info.doubled, (long)info.flipped, (long)info.open_edges);
    print_mesh(&mesh);
    printf("size         %.4g m\nvolume       %.6g m^3\n", info.size, info.volume);
    printf("angles       %.1f to %.1f degrees\nseconds      %.3f\n", info.min_dihedral, info.max_dihedral, begin);
    return mesh;
}

int main(int argc, char **argv)
{
    const ex_options o = ex_parse(argc, argv, "Tetrahedra that fill a surface.", table);
    const char *directory = ex_text(&o, "--out"), *in = ex_text(&o, "IN"), *out = ex_text(&o, "OUTPUT");
    sfem_mesh_read_def def = sfem_default_mesh_read_def();
    sfem_surface surface;
    sfem_error err;
    sfem_mesh mesh;
    int tets = 0;
    def.linear = ex_given(&o, "--linear");
    ex_make_directory(directory);
    if (!out) out = ex_path(directory, "mesh.msh");
    if (in && !ex_given(&o, "--tets") && !ex_given(&o, "--size") && !ex_given(&o, "--cage")) {
        tets = sfem_mesh_read_sets(in, &def, &mesh, NULL, NULL, &err) == SFEM_OK;
        if (!tets && strstr(err.text, "'linear'")) ex_fail("%s: here --linear", err.text);
        if (!tets && !strstr(err.text, "sfem_mesh_from_surface")) ex_fail("%s", err.text);
    }
    check_name(out);
    if (tets) {
        print_mesh(&mesh);
    } else if (in) {
        must(sfem_surface_read(in, NULL, &surface, &err), &err);
        mesh = fill(&o, &surface);
        sfem_surface_free(&surface);
    } else {
        surface = torus();
        mesh = fill(&o, &surface);
    }
    write_mesh(out, &mesh);
    draw(&mesh, ex_path(directory, "cut.png"));
    sfem_mesh_free(&mesh);
    return 0;
}
