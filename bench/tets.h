/* tets.h - linear and smooth tets beside references that engineers trust, and CalculiX's C3D4 and C3D10. Part of
 * bench/accuracy.c, which has row() and title().
 *
 *     Cook's membrane      [Cook 1974]: plane stress 23.96; nearly incompressible in plane strain, nu = 0.4999
 *     NAFEMS LE1, LE10     [The Standard NAFEMS Benchmarks, 1990]: sigma_yy at D 92.7 and -5.38 MPa
 *     NAFEMS FV32, FV52    [Abbassian, Dawswell, Knowles 1987: Selected Benchmarks for Natural Frequency Analysis]: a
 *                          tapered membrane, 44.623 to 391.44 Hz; a thick square plate on its lower edges, whose values,
 *                          45.897 to 206.19 Hz after three rigid motions, are those of plate theory
 *     a beam bent to a circle: the energy E I (2 pi)^2/(2 L)
 *     a rubber pad         [Chalhoub, Kelly 1990]: modulus K (1 - 2 I1(x)/(x I0(x))), x = R sqrt(12 G/(K t^2))
 *
 * Meshes are mapped blocks of six-tet cells. Plane stress is a slab on its middle plane. C3D10 has half as many cells
 * along each axis, so that all have about as many nodes. Lines without a verdict are for comparison. Stresses of linear and
 * smooth tets at a corner of the boundary are of first order: means over the tets around.
 */
#ifndef SFEM_BENCH_TETS_H
#define SFEM_BENCH_TETS_H

typedef struct tets_case {
    sfem_mesh mesh;
    sfem_material material;
    sfem_mass mass;
    unsigned char *held; /* [nodes] axes */
    double *force;       /* [nodes][3], of linear shape functions */
    double *traction;    /* [triangles][3] Pa, of surface triangles */
    sfem_surface surface;
    double *u, *stress; /* [nodes][3], [nodes][6] of the last solution */
    sfem_int iterations;
} tets_case;

static sfem_block_cells tets_cells = SFEM_CELL_6_TETS; /* of tets_open */

static tets_case tets_open(sfem_int nx, sfem_int ny, sfem_int nz, void (*map)(double x[3]),
                           double young, double poisson)
{
    const sfem_int cells[3] = {nx, ny, nz};
    const sfem_real size[3] = {1, 1, 1};
    tets_case c;
    sfem_error err;
    sfem_int i;
    memset(&c, 0, sizeof c);
    bench_must(sfem_mesh_block(cells, size, tets_cells, NULL, &c.mesh, &err), &err);
    for (i = 0; i < c.mesh.nodes; ++i) map(c.mesh.x + 3 * i);
    sfem_mesh_orient(&c.mesh);
    bench_must(sfem_mesh_surface(&c.mesh, NULL, &c.surface, &err), &err);
    c.material = material(SFEM_LINEAR, young, poisson);
    c.held = (unsigned char *)calloc((size_t)c.mesh.nodes, 1);
    c.force = reals(3 * c.mesh.nodes);
    c.u = reals(3 * c.mesh.nodes);
    c.stress = reals(6 * c.mesh.nodes);
    c.traction = reals(3 * c.surface.triangles);
    return c;
}

static void tets_close(tets_case *c)
{
    sfem_surface_free(&c->surface);
    sfem_mesh_free(&c->mesh);
    free(c->held), free(c->force), free(c->u), free(c->stress), free(c->traction);
}

/* A traction, or with t NULL the outward pressure -p, on the triangles all of whose corners are `in`. */
static void tets_load(tets_case *c, int (*in)(const double *x), const double *t, double p)
{
    sfem_int k;
    for (k = 0; k < c->surface.triangles; ++k) {
        const sfem_int *tri = c->surface.tri + 3 * k;
        const double *x0 = c->mesh.x + 3 * tri[0], *x1 = c->mesh.x + 3 * tri[1],
                     *x2 = c->mesh.x + 3 * tri[2];
        double n[3], size = 0;
        int i;
        if (!in(x0) || !in(x1) || !in(x2)) continue;
        for (i = 0; i < 3; ++i) {
            const int a = (i + 1) % 3, b = (i + 2) % 3;
            n[i] = (x1[a] - x0[a]) * (x2[b] - x0[b]) - (x1[b] - x0[b]) * (x2[a] - x0[a]);
            size += n[i] * n[i];
        }
        for (i = 0; i < 3; ++i) c->traction[3 * k + i] = t ? t[i] : -p * n[i] / sqrt(size);
        sfem_add_traction(&c->mesh, NULL, 1, tri, c->traction + 3 * k, c->force);
    }
}

static sfem_body_def tets_body_def(const tets_case *c, sfem_int *pins, unsigned char *axes)
{
    sfem_body_def def = sfem_default_body_def();
    sfem_int i;
    for (i = 0; i < c->mesh.nodes; ++i)
        if (c->held[i]) pins[def.pin_count] = i, axes[def.pin_count++] = c->held[i];
    def.pins = pins;
    def.pin_axes = axes;
    return def;
}

static sfem_model *tets_model(const tets_case *c, sfem_tet tet)
{
    sfem_model_def def = sfem_default_model_def();
    sfem_model *model;
    sfem_error err;
    def.mesh = &c->mesh;
    def.material = c->material;
    def.material.tet = tet;
    def.mass = c->mass;
    bench_must(sfem_model_create(&def, &model, &err), &err);
    return model;
}

/* Displacements and, at nodes, stresses; those of linear tets averaged by volume. */
static void tets_solve(tets_case *c, sfem_tet tet)
{
    sfem_int *pins = (sfem_int *)calloc((size_t)c->mesh.nodes, sizeof *pins), e;
    unsigned char *axes = (unsigned char *)calloc((size_t)c->mesh.nodes, 1);
    const sfem_body_def def = tets_body_def(c, pins, axes);
    sfem_model *model = tets_model(c, tet);
    double *own = reals(6 * c->mesh.tets), *volume = reals(c->mesh.nodes);
    sfem_body *body;
    sfem_error err;
    int a, k;
    bench_must(sfem_body_create(model, &def, &body, &err), &err);
    bench_must(sfem_body_set_lasting_force(body, c->force, &err), &err);
    bench_must(sfem_body_solve_static(body, &err), &err);
    c->iterations = sfem_body_newton(body).iterations;
    memcpy(c->u, sfem_body_displacement(body), 3 * (size_t)c->mesh.nodes * sizeof *c->u);
    if (tet == SFEM_TET_SMOOTH) {
        sfem_model_smooth_stress(model, c->u, c->stress, NULL);
    } else {
        sfem_model_stress(model, c->u, own, NULL);
        memset(c->stress, 0, 6 * (size_t)c->mesh.nodes * sizeof *c->stress);
        for (e = 0; e < c->mesh.tets; ++e)
            for (a = 0; a < 4; ++a) {
                const double v = sfem_model_tet_volume(model)[e];
                volume[c->mesh.tet[4 * e + a]] += v;
                for (k = 0; k < 6; ++k)
                    c->stress[6 * c->mesh.tet[4 * e + a] + k] += v * own[6 * e + k];
            }
        for (e = 0; e < c->mesh.nodes; ++e)
            for (k = 0; k < 6; ++k) c->stress[6 * e + k] /= volume[e];
    }
    sfem_body_free(body);
    sfem_model_free(model);
    free(pins), free(axes), free(own), free(volume);
}

/* The node nearest to a place. */
static sfem_int tets_at(const tets_case *c, double x, double y, double z)
{
    sfem_int i, best = 0;
    double least = 1e300;
    for (i = 0; i < c->mesh.nodes; ++i) {
        const double *p = c->mesh.x + 3 * i;
        const double d =
            (p[0] - x) * (p[0] - x) + (p[1] - y) * (p[1] - y) + (p[2] - z) * (p[2] - z);
        if (d < least) least = d, best = i;
    }
    return best;
}

/* ---- CalculiX ---- */

/* The number of the node in the middle of edge ij: the place of block (i, j) in the pattern of K. */
static sfem_int tets_middle(const sfem_matrix *k, sfem_int i, sfem_int j)
{
    sfem_int at;
    if (i < j) at = i, i = j, j = at;
    for (at = k->row[i]; k->col[at] != j; ++at) continue;
    return k->n + at;
}

static void tets_ccx_mesh(FILE *f, const tets_case *c, const sfem_matrix *k, int quadratic)
{
    static const int edge[6][2] = {{0, 1}, {1, 2}, {0, 2}, {0, 3}, {1, 3}, {2, 3}};
    sfem_int i, e, at;
    int a;
    fprintf(f, "*NODE, NSET=ALL\n");
    for (i = 0; i < c->mesh.nodes; ++i)
        fprintf(f, "%d, %.12g, %.12g, %.12g\n", (int)i + 1, c->mesh.x[3 * i], c->mesh.x[3 * i + 1],
                c->mesh.x[3 * i + 2]);
    for (i = 0; quadratic && i < k->n; ++i)
        for (at = k->row[i]; at < k->row[i + 1] - 1; ++at) {
            const double *p = c->mesh.x + 3 * i, *q = c->mesh.x + 3 * k->col[at];
            fprintf(f, "%d, %.12g, %.12g, %.12g\n", (int)(k->n + at) + 1, (p[0] + q[0]) / 2,
                    (p[1] + q[1]) / 2, (p[2] + q[2]) / 2);
        }
    fprintf(f, "*ELEMENT, TYPE=%s, ELSET=BODY\n", quadratic ? "C3D10" : "C3D4");
    for (e = 0; e < c->mesh.tets; ++e) {
        const sfem_int *t = c->mesh.tet + 4 * e;
        fprintf(f, "%d", (int)e + 1);
        for (a = 0; a < 4; ++a) fprintf(f, ", %d", (int)t[a] + 1);
        for (a = 0; quadratic && a < 6; ++a)
            fprintf(f, ", %d", (int)tets_middle(k, t[edge[a][0]], t[edge[a][1]]) + 1);
        fprintf(f, "\n");
    }
    fprintf(f, "*BOUNDARY\n");
    for (i = 0; i < c->mesh.nodes; ++i) {
        for (a = 0; a < 3; ++a)
            if (c->held[i] >> a & 1) fprintf(f, "%d, %d, %d\n", (int)i + 1, a + 1, a + 1);
        for (at = k->row[i]; quadratic && at < k->row[i + 1] - 1; ++at)
            for (a = 0; a < 3; ++a)
                if ((c->held[i] & c->held[k->col[at]]) >> a & 1)
                    fprintf(f, "%d, %d, %d\n", (int)(k->n + at) + 1, a + 1, a + 1);
    }
}

/* Nodal displacement or stress of CalculiX's result file: `block` is its name there, columns of twelve characters. */
static int tets_ccx_read(const char *path, const char *block, sfem_int node, int count, double *out)
{
    char line[256], number[16];
    int inside = 0, found = 0, k;
    FILE *f = fopen(path, "r");
    if (!f) return 0;
    while (fgets(line, sizeof line, f)) {
        if (!strncmp(line, " -4", 3)) inside = !strncmp(line + 5, block, strlen(block));
        if (!strncmp(line, " -3", 3)) inside = 0;
        if (!inside || strncmp(line, " -1", 3) || strlen(line) < (size_t)(13 + 12 * count))
            continue;
        memcpy(number, line + 3, 10);
        number[10] = 0;
        if (atoi(number) != (int)node + 1) continue;
        for (k = 0; k < count; ++k) {
            memcpy(number, line + 13 + 12 * k, 12);
            number[12] = 0;
            out[k] = atof(number);
        }
        found = 1;
    }
    fclose(f);
    return found;
}

/* u [3] and stress [6] (xx yy zz xy yz zx) at a node by CalculiX; 0 without it. */
static int tets_calculix(const tets_case *c, int quadratic, sfem_int node, double *u,
                         double *stress)
{
    char directory[BENCH_SCRATCH], text[400];
    sfem_model *model;
    const sfem_matrix *k;
    sfem_int t, i;
    int a, ok;
    FILE *f;
    if (system("command -v ccx >/dev/null 2>&1") || !bench_scratch(directory)) return 0;
    model = tets_model(c, SFEM_TET_LINEAR);
    k = sfem_model_stiffness(model);
    snprintf(text, sizeof text, "%s/a.inp", directory);
    f = fopen(text, "w");
    if (!f) return 0;
    tets_ccx_mesh(f, c, k, quadratic);
    fprintf(f,
            "*MATERIAL, NAME=M\n*ELASTIC\n%.16g, %.16g\n*SOLID SECTION, ELSET=BODY, "
            "MATERIAL=M\n*STEP\n*STATIC\n*CLOAD\n",
            c->material.young, c->material.poisson);
    for (i = 0; i < c->mesh.nodes && !quadratic; ++i)
        for (a = 0; a < 3; ++a)
            if (c->force[3 * i + a] != 0)
                fprintf(f, "%d, %d, %.12g\n", (int)i + 1, a + 1, c->force[3 * i + a]);
    for (t = 0; t < c->surface.triangles && quadratic;
         ++t) { /* a third each in the middles of the edges */
        const sfem_int *tri = c->surface.tri + 3 * t;
        double third[9];
        memset(third, 0, sizeof third);
        { /* at corners 0, 1, 2 of a triangle by itself */
            double x[9];
            sfem_int own[3] = {0, 1, 2};
            sfem_mesh one;
            memset(&one, 0, sizeof one);
            for (a = 0; a < 9; ++a) x[a] = c->mesh.x[3 * tri[a / 3] + a % 3];
            one.nodes = 3;
            one.x = x;
            sfem_add_traction(&one, NULL, 1, own, c->traction + 3 * t, third);
        }
        for (i = 0; i < 3; ++i)
            for (a = 0; a < 3; ++a)
                if (third[a] != 0)
                    fprintf(f, "%d, %d, %.12g\n", (int)tets_middle(k, tri[i], tri[(i + 1) % 3]) + 1,
                            a + 1, third[a]);
    }
    fprintf(f, "*NODE FILE\nU\n*EL FILE\nS\n*END STEP\n");
    fclose(f);
    snprintf(text, sizeof text, "cd '%s' && OMP_NUM_THREADS=1 ccx a >a.log 2>&1", directory);
    ok = system(text) == 0;
    snprintf(text, sizeof text, "%s/a.frd", directory);
    ok = ok && tets_ccx_read(text, "DISP", node, 3, u) &&
         tets_ccx_read(text, "STRESS", node, 6, stress);
    bench_scratch_remove(directory);
    sfem_model_free(model);
    return ok;
}

/* Frequencies after the first `zero` by CalculiX; 0 without it. */
static int tets_ccx_modes(const tets_case *c, int quadratic, int zero, int count, double *hz)
{
    char directory[BENCH_SCRATCH], text[400];
    sfem_model *model;
    int found = 0, mode;
    FILE *f;
    if (system("command -v ccx >/dev/null 2>&1") || !bench_scratch(directory)) return 0;
    model = tets_model(c, SFEM_TET_LINEAR);
    snprintf(text, sizeof text, "%s/a.inp", directory);
    f = fopen(text, "w");
    if (!f) return 0;
    tets_ccx_mesh(f, c, sfem_model_stiffness(model), quadratic);
    sfem_model_free(model);
    fprintf(f,
            "*MATERIAL, NAME=M\n*ELASTIC\n%.16g, %.16g\n*DENSITY\n%.16g\n*SOLID SECTION, ELSET=BODY, "
            "MATERIAL=M\n*STEP\n*FREQUENCY\n%d\n*END STEP\n",
            c->material.young, c->material.poisson, c->material.density, zero + count);
    fclose(f);
    snprintf(text, sizeof text, "cd '%s' && OMP_NUM_THREADS=1 ccx a >a.log 2>&1", directory);
    if (system(text) == 0) {
        snprintf(text, sizeof text, "%s/a.dat", directory);
        f = fopen(text, "r");
        while (f && found < count && fgets(text, sizeof text, f)) { /* number, eigenvalue, rad/s, Hz, imaginary part */
            double value[4];
            if (sscanf(text, "%d %lf %lf %lf %lf", &mode, value, value + 1, value + 2, value + 3) == 5 &&
                mode == zero + found + 1)
                hz[found++] = value[2];
        }
        if (f) fclose(f);
    }
    bench_scratch_remove(directory);
    return found == count;
}

/* One reference value: by linear and smooth tets and CalculiX, over the expected. which: 0 to 2 u, 3 to 8 stress. */
typedef struct tets_reference {
    const char *name;
    double expected, tolerance; /* of the smooth tets, of 1 */
    int which;
    double place[3];
    int ccx;
} tets_reference;

typedef tets_case (*tets_make)(int n);

static void tets_compare(const tets_reference *r, tets_make make, int n)
{
    double part[2], u[3], stress[6];
    sfem_int node;
    int tet, quadratic;
    tets_case c = make(n);
    node = tets_at(&c, r->place[0], r->place[1], r->place[2]);
    for (tet = 0; tet < 2; ++tet) {
        tets_solve(&c, (sfem_tet)tet);
        part[tet] = (r->which < 3 ? c.u[3 * node + r->which] : c.stress[6 * node + r->which - 3]) /
                    r->expected;
    }
    row(1, part[1], r->tolerance, "%s, %d nodes, %d solves; linear %.3f", r->name,
        (int)c.mesh.nodes, (int)c.iterations, part[0]);
    if (r->ccx && tets_calculix(&c, 0, node, u, stress))
        printf("    (C3D4 %.3f", (r->which < 3 ? u[r->which] : stress[r->which - 3]) / r->expected);
    else
        printf("    (no CalculiX");
    tets_close(&c);
    c = make(n / 2);
    node = tets_at(&c, r->place[0], r->place[1], r->place[2]);
    quadratic = r->ccx && tets_calculix(&c, 1, node, u, stress);
    if (quadratic)
        printf("; C3D10 on half as many cells a side %.3f",
               (r->which < 3 ? u[r->which] : stress[r->which - 3]) / r->expected);
    printf(")\n");
    tets_close(&c);
}

/* ---- Cook's membrane ---- */

static void tets_cook_map(double x[3])
{
    const double s = x[0], t = x[1];
    x[0] = 48 * s;
    x[1] = 44 * s + t * (44 - 28 * s);
    x[2] *= 2;
}

static int tets_cook_end(const double *x) { return x[0] > 48 - 1e-9; }

static tets_case tets_cook(int n, double young, double poisson, int strain)
{
    const double shear[3] = {0, 1.0 / 16, 0};
    tets_case c = tets_open(n, n, 1, tets_cook_map, young, poisson);
    sfem_int i;
    for (i = 0; i < c.mesh.nodes; ++i) {
        if (c.mesh.x[3 * i] < 1e-9) c.held[i] = SFEM_AXIS_X | SFEM_AXIS_Y;
        if (strain || c.mesh.x[3 * i + 2] < 1e-9) c.held[i] |= SFEM_AXIS_Z;
    }
    tets_load(&c, tets_cook_end, shear, 0);
    return c;
}

static tets_case tets_cook_stress(int n) { return tets_cook(n, 1, 1.0 / 3, 0); }
static tets_case tets_cook_strain(int n) { return tets_cook(n, 1.1249, 0.4999, 1); }

/* ---- NAFEMS LE1 and LE10: a quarter of an elliptic ring ---- */

static double tets_thickness = 0.1;

static void tets_ring_map(double x[3])
{
    const double r = x[0], angle = x[1] * PI / 2;
    x[0] = (2 + 1.25 * r) * cos(angle);
    x[1] = (1 + 1.75 * r) * sin(angle);
    x[2] *= tets_thickness;
}

static int tets_ring_outer(const double *x)
{
    return fabs(x[0] * x[0] / (3.25 * 3.25) + x[1] * x[1] / (2.75 * 2.75) - 1) < 1e-9;
}

static int tets_ring_top(const double *x) { return x[2] > tets_thickness - 1e-9; }

static void tets_ring_hold(tets_case *c)
{
    sfem_int i;
    for (i = 0; i < c->mesh.nodes; ++i) {
        if (fabs(c->mesh.x[3 * i]) < 1e-9) c->held[i] |= SFEM_AXIS_X;
        if (fabs(c->mesh.x[3 * i + 1]) < 1e-9) c->held[i] |= SFEM_AXIS_Y;
    }
}

static tets_case tets_le1(int n)
{
    tets_case c;
    sfem_int i;
    tets_thickness = 0.05; /* half of it: on the middle plane */
    c = tets_open(n, 2 * n, 1, tets_ring_map, 210e3, 0.3);
    tets_ring_hold(&c);
    for (i = 0; i < c.mesh.nodes; ++i)
        if (c.mesh.x[3 * i + 2] < 1e-9) c.held[i] |= SFEM_AXIS_Z;
    tets_load(&c, tets_ring_outer, NULL, -10);
    return c;
}

static tets_case tets_le10(int n)
{
    tets_case c;
    sfem_int i;
    tets_thickness = 0.6;
    c = tets_open(n, 2 * n, n / 6 * 2, tets_ring_map, 210e3, 0.3);
    tets_ring_hold(&c);
    for (i = 0; i < c.mesh.nodes; ++i) {
        const double *x = c.mesh.x + 3 * i;
        if (!tets_ring_outer(x)) continue;
        c.held[i] |= SFEM_AXIS_X | SFEM_AXIS_Y;
        if (fabs(x[2] - 0.3) < 1e-9) c.held[i] |= SFEM_AXIS_Z;
    }
    tets_load(&c, tets_ring_top, NULL, 1);
    return c;
}

/* ---- NAFEMS FV32 ---- */

static void tets_fv32_map(double x[3])
{
    const double s = x[0];
    x[0] = 10 * s;
    x[1] = (x[1] - 0.5) * (5 - 4 * s);
    x[2] *= 0.2;
}

static tets_case tets_fv32(int n)
{
    tets_case c = tets_open(2 * n, n, 1, tets_fv32_map, 200e9, 0.3);
    sfem_int i;
    for (i = 0; i < c.mesh.nodes; ++i) {
        if (c.mesh.x[3 * i] < 1e-9) c.held[i] = SFEM_AXIS_X | SFEM_AXIS_Y;
        if (c.mesh.x[3 * i + 2] < 1e-9) c.held[i] |= SFEM_AXIS_Z;
    }
    return c;
}

static void tets_fv52_map(double x[3]) { x[0] *= 10, x[1] *= 10; }

static tets_case tets_fv52(int n)
{
    tets_case c = tets_open(n, n, n / 4, tets_fv52_map, 200e9, 0.3);
    sfem_int i;
    for (i = 0; i < c.mesh.nodes; ++i) {
        const double *x = c.mesh.x + 3 * i;
        const int side = x[0] < 1e-9 || x[0] > 10 - 1e-9 || x[1] < 1e-9 || x[1] > 10 - 1e-9;
        if (side && x[2] < 1e-9) c.held[i] = SFEM_AXIS_Z;
    }
    return c;
}

/* Frequencies, of which the first `zero` are 0 and left out. */
static void tets_frequencies(const char *name, const tets_make make, int n, int zero, int count, const double *hz,
                             double tolerance, int ccx)
{
    enum { MOST = 10 };
    double found[2][MOST], c3d4[MOST], c3d10[MOST];
    tets_case c = make(n), half;
    sfem_int *pins = (sfem_int *)calloc((size_t)c.mesh.nodes, sizeof *pins);
    unsigned char *axes = (unsigned char *)calloc((size_t)c.mesh.nodes, 1);
    int tet, k, linear, quadratic;
    c.material.density = 8000;
    for (tet = 0; tet < 2; ++tet) {
        const sfem_body_def body = tets_body_def(&c, pins, axes);
        sfem_model *model = tets_model(&c, (sfem_tet)tet);
        sfem_modes_def def = sfem_default_modes_def();
        sfem_modes modes;
        sfem_error err;
        def.modes = count; /* without the rigid ones */
        def.pins = body.pins;
        def.pin_axes = body.pin_axes;
        def.pin_count = body.pin_count;
        bench_must(sfem_modes_create(model, &def, &modes, &err), &err);
        for (k = 0; k < count; ++k) found[tet][k] = sfem_modes_hz(&modes, k);
        sfem_modes_free(&modes);
        sfem_model_free(model);
    }
    linear = ccx && tets_ccx_modes(&c, 0, zero, count, c3d4);
    half = make(n / 2);
    half.material.density = 8000;
    quadratic = ccx && tets_ccx_modes(&half, 1, zero, count, c3d10);
    for (k = 0; k < count; ++k) {
        row(1, found[1][k] / hz[k], tolerance, "%s, mode %d, %d nodes, over %.2f Hz; linear %.3f", name, zero + k + 1,
            (int)c.mesh.nodes, hz[k], found[0][k] / hz[k]);
        if (linear && quadratic)
            printf("    (C3D4 %.3f; C3D10 on half as many cells a side %.3f)\n", c3d4[k] / hz[k], c3d10[k] / hz[k]);
        else
            printf("    (no CalculiX)\n");
    }
    free(pins), free(axes);
    tets_close(&c);
    tets_close(&half);
}

/* ---- a beam bent to a circle ---- */

static void tets_beam_map(double x[3])
{
    x[0] *= 15;
    x[1] = 0.5 * (x[1] - 0.5);
    x[2] = 0.5 * (x[2] - 0.5);
}

/* The energy of a corotational beam whose ends meet, over E I (2 pi)^2/(2 L); NAN where Newton fails. */
static double tets_circle(sfem_tet tet, double poisson)
{
    enum { TURNS = 24 };
    tets_case c = tets_open(60, 3, 3, tets_beam_map, 1e6, poisson);
    sfem_int *pins = (sfem_int *)calloc((size_t)c.mesh.nodes, sizeof *pins), i;
    unsigned char *axes = (unsigned char *)calloc((size_t)c.mesh.nodes, 1);
    double energy;
    sfem_body_def def;
    sfem_model *model;
    sfem_body *body;
    sfem_error err;
    int k, ok = 1;
    c.material.law = SFEM_COROTATIONAL;
    for (i = 0; i < c.mesh.nodes; ++i)
        if (c.mesh.x[3 * i] < 1e-9 || c.mesh.x[3 * i] > 15 - 1e-9) c.held[i] = SFEM_AXIS_ALL;
    model = tets_model(&c, tet);
    def = tets_body_def(&c, pins, axes);
    def.newton.tolerance = 1e-5;
    bench_must(sfem_body_create(model, &def, &body, &err), &err);
    for (k = 1; k <= TURNS && ok; ++k) {
        const double angle = 2 * PI * k / TURNS, radius = 15 / angle;
        for (i = 0; i < c.mesh.nodes; ++i) {
            const double *x = c.mesh.x + 3 * i;
            double at[3];
            if (!c.held[i] || x[0] < 1e-9) continue;
            at[0] = (radius - x[2]) * sin(angle);
            at[1] = x[1];
            at[2] = radius - (radius - x[2]) * cos(angle);
            bench_must(sfem_body_move_pin(body, i, at, &err), &err);
        }
        ok = sfem_body_solve_static(body, &err) == SFEM_OK;
    }
    energy = sfem_body_energy(body).elastic / (1e6 * 0.0625 / 12 * 4 * PI * PI / 30);
    sfem_body_free(body);
    sfem_model_free(model);
    free(pins), free(axes);
    tets_close(&c);
    return ok ? energy : NAN;
}

/* ---- a rubber pad ---- */

/* I_order(x) by its series. */
static double tets_bessel(int order, double x)
{
    double term = order ? x / 2 : 1, sum = term;
    int k;
    for (k = 1; k < 60; ++k) {
        term *= x * x / 4 / (k * (k + order));
        sum += term;
    }
    return sum;
}

/* Force on a bonded disc of radius 1 and thickness 0.2 m (shape factor 2.5) compressed by 1 %, over Kelly's. */
static double tets_pad(sfem_tet tet, double poisson)
{
    const double bulk = 1e6 / (3 * (1 - 2 * poisson)), shear = 1e6 / (2 * (1 + poisson));
    const double x = sqrt(12 * shear / (bulk * 0.04));
    const double modulus = bulk * (1 - 2 * tets_bessel(1, x) / (x * tets_bessel(0, x)));
    sfem_model_def model_def = sfem_default_model_def();
    sfem_body_def def = sfem_default_body_def();
    sfem_int *pins, i;
    sfem_mesh mesh;
    sfem_model *model;
    sfem_body *body;
    sfem_error err;
    double *reaction, force = 0, area = 0;
    bench_must(sfem_mesh_cylinder(1, 0.2, 12, 4, NULL, &mesh, &err), &err);
    pins = (sfem_int *)calloc((size_t)mesh.nodes, sizeof *pins);
    reaction = reals(3 * mesh.nodes);
    model_def.mesh = &mesh;
    model_def.material = material(SFEM_LINEAR, 1e6, poisson);
    model_def.material.tet = tet;
    bench_must(sfem_model_create(&model_def, &model, &err), &err);
    for (i = 0; i < mesh.nodes; ++i)
        if (mesh.x[3 * i] < 1e-9 || mesh.x[3 * i] > 0.2 - 1e-9) pins[def.pin_count++] = i;
    def.pins = pins;
    bench_must(sfem_body_create(model, &def, &body, &err), &err);
    for (i = 0; i < def.pin_count; ++i) {
        double at[3];
        memcpy(at, mesh.x + 3 * pins[i], sizeof at);
        if (at[0] < 1e-9) continue;
        at[0] -= 0.002;
        bench_must(sfem_body_move_pin(body, pins[i], at, &err), &err);
    }
    bench_must(sfem_body_solve_static(body, &err), &err);
    sfem_body_reactions(body, reaction);
    for (i = 0; i < mesh.nodes; ++i)
        if (mesh.x[3 * i] < 1e-9) force += reaction[3 * i];
    for (i = 0; i < mesh.tets; ++i) area += sfem_model_tet_volume(model)[i] / 0.2;
    sfem_body_free(body);
    sfem_model_free(model);
    sfem_mesh_free(&mesh);
    free(pins), free(reaction);
    return force / (area * 0.01 * modulus);
}

static void tets(int ccx)
{
    const tets_reference cook = {
        "Cook's membrane, plane stress, over 23.96", 23.96, 0.03, 1, {48, 52, 0}, ccx};
    const tets_reference rubber = {
        "Cook's membrane, plane strain, nu 0.4999, over 16.44", 16.44, 0.04, 1, {48, 52, 0}, ccx};
    const tets_reference le1 = {
        "NAFEMS LE1, stress at D, over 92.7 MPa", 92.7, 0.08, 4, {2, 0, 0}, ccx};
    const tets_reference le10 = {
        "NAFEMS LE10, stress at D, over -5.38 MPa", -5.38, 0.1, 4, {2, 0, 0.6}, ccx};
    static const double fv32[6] = {44.623, 130.03, 162.70, 246.05, 379.90, 391.44};
    static const double fv52[7] = {45.897, 109.44, 109.44, 167.89, 193.59, 206.19, 206.19};
    title("smooth tets against references, linear ones beside them: found over expected");
    tets_compare(&cook, tets_cook_stress, 16);
    tets_compare(&rubber, tets_cook_strain, 16);
    tets_compare(&le1, tets_le1, 32);
    tets_compare(&le10, tets_le10, 18);
    tets_frequencies("NAFEMS FV32", tets_fv32, 16, 0, 6, fv32, 0.03, ccx);
    tets_frequencies("NAFEMS FV52", tets_fv52, 16, 3, 7, fv52, 0.05, ccx);
    row(1, tets_circle(SFEM_TET_SMOOTH, 0.45), 0.05,
        "beam bent to a circle, nu 0.45, energy over E I (2 pi)^2/(2 L); linear %.3f",
        tets_circle(SFEM_TET_LINEAR, 0.45));
    row(1, tets_pad(SFEM_TET_SMOOTH, 0.499), 0.1,
        "rubber pad, nu 0.499, force over Kelly's; linear %.3f", tets_pad(SFEM_TET_LINEAR, 0.499));
}

#endif
