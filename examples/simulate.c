/* simulate - an elastic body on the command line:  M u'' + D u' + K u = F
 *
 *        fixed                                         simulate                      a clamped bar swings
 *     //|=======================  <- load              simulate body.msh --fix 'x<0.01' --static
 *     //|=======================                       simulate --help
 *          | gravity                                     simulate --fix none --floor 'z=-0.5'
 *
 * Reads or makes a mesh, fixes and loads nodes, solves for rest or steps through time, and leaves
 * pictures, a plot and tables in the --out directory. The last lines on stdout are `key value`.
 */
#include "support.h"
#include "softfem.h"
#include "elastic.h"

enum { FRAMES = 6, MAX_OBSTACLES = 32, MAX_STEPS = 10000000 };

static const ex_option table[] = {
    {"MESH", "FILE", NULL,
     "tets: Gmsh .msh, VTK .vtk and .vtu, Medit .mesh and .meshb, Abaqus .inp, Vega .veg, TetGen .node; with --tets "
     "a surface: .obj, .stl, .ply, .off or the triangles of one of those; without it a bar of 1 x 0.2 x 0.2 m"},
    {"--surface", "FILE", NULL,
     "a .obj, .stl, .ply or .off that moves with the body and is drawn in its place; it is cut where "
     "the body breaks"},
    {"--tets", "N", "5000", "fill the surface in the file with so many tets; only if this or the next is given"},
    {"--cage", NULL, NULL, "fill it with whole tets of a lattice that contain the surface, filled in part"},
    {"--linear", NULL, NULL, "10-node tets of the file become 4-node ones"},
    {"--weld", "D", NULL, "nodes at most D apart become one, m; 0: exactly at one place"},
    {"--info", NULL, NULL, "tell all about the mesh, its sets and regions, and stop"},
    {"--cells", "NX,NY,NZ", "20,4,4", "cells of the bar, five tets each"},
    {"--material", "linear|corotational|stvk|neohookean", "corotational",
     "the law of the material"},
    {"--tet", "linear|smooth", "linear",
     "linear tets lock in bending and as nu nears 0.5, smooth ones do not"},
    {"--young", "E", "1.5e5", "Young's modulus, Pa"},
    {"--poisson", "NU", "0.3", "Poisson's ratio"},
    {"--density", "RHO", "1000", "kg/m^3; the three are of all tets, else the file's constants, where it has them"},
    {"--region", "NAME:E,NU,RHO", NULL, "those of one region of the file; repeatable"},
    {"--mass", "lumped|consistent", "lumped", "the mass matrix"},
    {"--rayleigh", "A0,A1", "0,0.002", "damping A0 M + A1 K: 1/s, s"},
    {"--integrator", "pqr|newmark|central|kr|gui|chang|be|hht|genalpha|bathe|modal", "pqr",
     "how to step through time"},
    {"--p", "P", "-2",
     "of pqr; -2 lets the library choose, -1 smaller where it may; beta of newmark"},
    {"--q", "Q", "1", "of pqr"},
    {"--r", "R", "1", "of pqr"},
    {"--frame", "node|piece|rest|majorant", "node",
     "of pqr, kr, gui, chang: how their factor is rotated"},
    {"--safeguard", "on|off", "on", "of the same: reject and replace steps that make energy"},
    {"--accuracy", "A", "1e-6",
     "of pqr: corrections stop below this part of the energy in motion; 1: one solve a step"},
    {"--dissipation", "ALPHA", "0.1",
     "of corrected pqr, 0 to 1/3: damps what a step does not resolve; 0: conservative"},
    {"--newton", "N", "20",
     "implicit methods: at most so many iterations a step; 1: semi-implicit"},
    {"--tol", "T", "1e-8", "Newton stops at this residual"},
    {"--rho-inf", "R", "0.8",
     "of genalpha and kr: what is left of the fastest modes a step; kr of 1 is CR"},
    {"--gui-lambda", "L", "4", "of gui: 4 is CR; beyond, steps are limited"},
    {"--fracture", "GC", NULL, "the body breaks: toughness, J/m^2 (examples/fracture.c has more)"},
    {"--strength", "S", NULL, "it breaks above this stress, Pa; with --fracture both must be met"},
    {"--damage", "zsz|condensed", "condensed", "the law of damaged tets"},
    {"--precision", "double|mixed", "double", "mixed keeps the factor in float"},
    {"--dt", "H", "0.008333333333333333", "time step, s"},
    {"--steps", "N", "240", "time steps"},
    {"--modes", "N", "20", "of modal: so many of the lowest"},
    {"--warp", "none|rotation|path", "path", "of modal: how they rotate; none is linear"},
    {"--static", NULL, NULL, "solve for rest instead"},
    {"--gravity", "X,Y,Z", "0,0,-9.81", "m/s^2"},
    {"--velocity", "V", NULL,
     "at the start: 'X,Y,Z', 'spin:WX,WY,WZ' or 'random:SPEED,SEED'; repeatable"},
    {"--fix", "WHERE", NULL,
     "nodes held, as 'x<0.01', the default for the bar, as 'set:NAME', a set or region of the file, or 'none'; "
     "repeatable"},
    {"--load", "WHERE:X,Y,Z", NULL, "newtons in all, shared evenly by those nodes, also 'set:NAME:X,Y,Z'; repeatable"},
    {"--grab", "X,Y,Z,RADIUS", NULL,
     "a handle takes hold of the surface there (at the place at rest)"},
    {"--pull", "VX,VY,VZ", "0.2,0,0", "and moves, m/s"},
    {"--grip", "F", "0", "with this force at most, N; 0: without limit"},
    {"--floor", "AXIS=D", NULL, "an obstacle below, as 'z=0'; '-x=2': beyond x = 2; repeatable"},
    {"--obstacle", "KIND:X,Y,Z,R,VX,VY,VZ", NULL,
     "'sphere:...', of radius R, that moves at this velocity; repeatable"},
    {"--friction", "MU", "0.5", "of the body and of obstacles"},
    {"--restitution", "E", "0", "of the same, for each node"},
    {"--probe", "NODE", "-1", "print this node's displacement; the plot follows it"},
    {"--threads", "N", "1", "threads"},
    {"--out", "DIR", "build/simulate", "where files go"},
    {"--csv", "FILE", NULL, "the final node,ux,uy,uz"},
    {"--vtu", "N", "0", "write every Nth step for ParaView; 0: none"},
    {"--quick", NULL, NULL, "a small run: fewer steps"},
    {NULL, NULL, NULL, NULL}};

typedef struct look { /* the --surface in a frame: outer triangles, then inner ones */
    double *x;
    int32_t *tri;
    sfem_int nodes, outer, inner;
} look;

typedef struct obstacle { /* what is needed to see how deep a node is in it */
    sfem_int id;
    int sphere;
    double normal[3], point[3], radius;
} obstacle;

typedef struct run {
    ex_options o;
    sfem_mesh mesh;
    sfem_mesh_sets sets;
    sfem_mesh_read_info read;
    sfem_mesher_info mesher; /* of --tets */
    sfem_surface surface;
    sfem_model *model;
    sfem_body *body;
    sfem_contact *contact; /* NULL: nothing to touch */
    obstacle obstacle[MAX_OBSTACLES];
    int obstacles;
    double penetration;
    sfem_modes
        modes; /* --integrator modal: these step instead of the body, which keeps pins and loads */
    sfem_reduced *reduced;
    sfem_reduced_view *view;
    sfem_modal *modal;
    double *u, *load;               /* [nodes][3] of modal: displacement; loads without gravity */
    sfem_int probe, steps, hand;    /* -1: none */
    double held[3];                 /* where it took hold */
    double h, setup, stepping;      /* seconds */
    double *time, *tip, *energy[3]; /* [steps + 1] */
    double *frame[FRAMES];          /* positions to draw */
    double frame_time[FRAMES];
    int breaks;
    int32_t *whole[FRAMES]; /* surface triangles that were whole then */
    sfem_int wholes[FRAMES];
    sfem_surface render;
    sfem_embed *embed;
    look look[FRAMES];
    int frames;
} run;

static void must(sfem_status status, const sfem_error *err)
{
    if (status != SFEM_OK) ex_fail("%s", err->text);
}

/* 1. The mesh, and what is to be known about it. */
static void show_progress(sfem_real part, void *user)
{
    (void)user;
    ex_progress("tets", (long)(1000 * part), 1000);
}

static void fill_surface(run *r, const char *path)
{
    sfem_mesher_def def = sfem_default_mesher_def();
    sfem_surface s;
    sfem_error err;
    must(sfem_surface_read(path, NULL, &s, &err), &err);
    def.mode = ex_given(&r->o, "--cage") ? SFEM_CAGE : SFEM_FITTED;
    def.tets = (sfem_int)ex_integer(&r->o, "--tets");
    def.exec.threads = (sfem_int)ex_count(&r->o, "--threads", 1);
    def.progress = show_progress;
    show_progress(0, NULL); /* the clock starts */
    must(sfem_mesh_from_surface(&def, &s, &r->mesh, &r->mesher, &err), &err);
    sfem_surface_free(&s);
}

/* A file that has only triangles: how to make tets of them. */
__attribute__((noreturn)) static void refuse_mesh(const char *path, const sfem_error *err)
{
    sfem_surface s;
    if (strstr(err->text, "'linear'")) ex_fail("%s: here --linear", err->text);
    if (!strstr(err->text, "sfem_mesh_from_surface") || sfem_surface_read(path, NULL, &s, NULL) != SFEM_OK)
        ex_fail("%s", err->text);
    ex_fail("%s: this file has %ld triangles and no tets; --tets 5000 makes some", path, (long)s.triangles);
}

static void read_file(run *r, const char *path)
{
    sfem_mesh_read_def def = sfem_default_mesh_read_def();
    sfem_error err;
    def.linear = ex_given(&r->o, "--linear");
    def.weld = ex_given(&r->o, "--weld");
    if (def.weld) def.weld_distance = ex_real(&r->o, "--weld");
    if (sfem_mesh_read_sets(path, &def, &r->mesh, &r->sets, &r->read, &err) == SFEM_OK) return;
    if (err.status == SFEM_BAD_MESH || err.status == SFEM_FORMAT) refuse_mesh(path, &err);
    ex_fail("%s", err.text);
}

static void make_bar(run *r)
{
    const sfem_real size[3] = {1, 0.2, 0.2};
    double cells[3];
    sfem_int n[3];
    sfem_error err;
    int k;
    ex_reals(&r->o, "--cells", 3, cells);
    for (k = 0; k < 3; ++k) {
        if (!(cells[k] >= 1 && cells[k] <= 1e6) || cells[k] != floor(cells[k]))
            ex_fail("--cells: %g is not a whole number from 1 to 1e6", cells[k]);
        n[k] = (sfem_int)cells[k];
    }
    must(sfem_mesh_block(n, size, SFEM_CELL_5_TETS, NULL, &r->mesh, &err), &err);
}

static void print_sets(const sfem_mesh_sets *s)
{
    sfem_int i;
    for (i = 0; i < s->regions; ++i) {
        const sfem_region *g = s->region + i;
        printf("region '%s': number %ld, %ld tets", g->name, (long)g->number, (long)g->tets);
        if (g->material[0]) printf(", material '%s'", g->material);
        if (g->has_elastic) printf(", E %g Pa, nu %g", g->young, g->poisson);
        if (g->has_density) printf(", %g kg/m^3", g->density);
        printf("\n");
    }
    for (i = 0; i < s->sets; ++i)
        printf("set '%s': %ld %s\n", s->set[i].name, (long)s->set[i].count, s->set[i].of_tets ? "tets" : "nodes");
}

static void print_info(const run *r, const sfem_mesh_report *m)
{
    const sfem_mesher_info *s = &r->mesher;
    printf("box: %g to %g, %g to %g, %g to %g m\n", m->box[0][0], m->box[1][0], m->box[0][1], m->box[1][1], m->box[0][2],
           m->box[1][2]);
    printf("surface: %ld triangles, %ld edges, %ld nodes, Euler characteristic %ld\n", (long)m->surface_triangles,
           (long)m->surface_edges, (long)m->surface_nodes, (long)m->euler);
    printf("quality: %.3f to 1, mean %.3f, worst in tet %ld; edges %.3g to %.3g m\n", m->min_quality, m->mean_quality,
           (long)m->worst_tet, m->min_edge, m->max_edge);
    printf("components: %ld; faces with two tets on one side: %ld\n", (long)m->components, (long)m->overlapping);
    printf("mended: %ld left-handed tets, %ld 10-node tets made linear, %ld nodes welded\n", (long)r->read.swapped,
           (long)r->read.linear, (long)r->read.welded);
    printf("left out: %ld volume cells that are no tets, %ld nodes of 10-node tets\n", (long)r->read.others,
           (long)r->read.removed);
    if (s->size > 0)
        printf("the surface: %ld triangles without area and %ld doubled ones left out, %ld reversed, %ld open edges\n",
               (long)s->degenerate, (long)s->doubled, (long)s->flipped, (long)s->open_edges);
    print_sets(&r->sets);
}

static void read_mesh(run *r)
{
    const char *path = ex_text(&r->o, "MESH");
    sfem_mesh_report report;
    sfem_status status;
    sfem_error err;
    if ((ex_given(&r->o, "--weld") || ex_given(&r->o, "--linear")) &&
        (!path || ex_given(&r->o, "--tets") || ex_given(&r->o, "--cage")))
        ex_fail("--weld and --linear are of a file with tets, and here is %s", path ? "a surface" : "none");
    if ((ex_given(&r->o, "--tets") || ex_given(&r->o, "--cage")) && !path)
        ex_fail("--tets and --cage fill the surface in a file, and here is none");
    if (!path)
        make_bar(r);
    else if (ex_given(&r->o, "--tets") || ex_given(&r->o, "--cage"))
        fill_surface(r, path);
    else
        read_file(r, path);
    status = sfem_mesh_check(&r->mesh, &report, &err);
    if (status == SFEM_OUT_OF_MEMORY || status == SFEM_TOO_LARGE) ex_fail("%s", err.text);
    printf("mesh: %d nodes, %d tets, volume %.4g m^3, worst quality %.2f, %d piece%s\n",
           (int)r->mesh.nodes, (int)r->mesh.tets, report.volume, report.min_quality,
           (int)report.components, report.components == 1 ? "" : "s");
    if (report.unused > 0)
        printf("      %d nodes in no tet stay where they are\n", (int)report.unused);
    if (report.seam > 0)
        printf("warning: duplicate nodes split the body along %ld faces: %ld components instead of %ld; --weld 0 joins them\n",
               (long)report.seam / 2, (long)report.components, (long)report.welded_components);
    if (ex_given(&r->o, "--info")) {
        print_info(r, &report);
        if (status != SFEM_OK) printf("it cannot be used: %s\n", err.text);
        exit(status != SFEM_OK);
    }
    must(status, &err);
    must(sfem_mesh_surface(&r->mesh, NULL, &r->surface, &err), &err);
}

/* A name that is not there: tells those that are. */
__attribute__((noreturn)) static void refuse_name(const run *r, const char *option, const char *name, int sets)
{
    sfem_int i;
    fflush(stdout); /* which a pipe keeps longer */
    fprintf(stderr, "%s: there is no %s '%s' in this mesh. Regions:", option, sets ? "set" : "region", name);
    for (i = 0; i < r->sets.regions; ++i) fprintf(stderr, " '%s'", r->sets.region[i].name);
    if (!r->sets.regions) fprintf(stderr, " none");
    if (sets) fprintf(stderr, ". Sets:");
    for (i = 0; sets && i < r->sets.sets; ++i) fprintf(stderr, " '%s'", r->sets.set[i].name);
    ex_fail(sets && !r->sets.sets ? " none" : "");
}

/* The surface that is drawn: each of its points goes with a tet. */
static void read_surface(run *r)
{
    const char *path = ex_text(&r->o, "--surface");
    sfem_embed_def def = sfem_default_embed_def();
    sfem_embed_info info;
    sfem_error err;
    if (!path) return;
    must(sfem_surface_read(path, NULL, &r->render, &err), &err);
    def.points = r->render.nodes;
    def.x = r->render.x;
    def.triangles = r->render.triangles;
    def.tri = r->render.tri;
    must(sfem_embed_create(&r->mesh, &def, &r->embed, &err), &err);
    info = sfem_embed_get_info(r->embed);
    printf("surface: %d points, %d triangles, %d points outside, up to %.3g m\n", (int)info.points,
           (int)info.triangles, (int)info.outside, info.distance);
}

/* 2. Material and mass: K, M, D. */
static sfem_material material_of_all(const run *r)
{
    sfem_material m = sfem_default_material();
    double rayleigh[2];
    ex_reals(&r->o, "--rayleigh", 2, rayleigh);
    m.young = ex_real(&r->o, "--young");
    m.poisson = ex_real(&r->o, "--poisson");
    m.density = ex_real(&r->o, "--density");
    m.mass_damping = rayleigh[0];
    m.stiffness_damping = rayleigh[1];
    m.law = (sfem_law)ex_choice(&r->o, "--material"); /* in the order of the enumeration */
    m.tet = (sfem_tet)ex_choice(&r->o, "--tet");      /* likewise */
    return m;
}

/* One material for each region: the file's constants unless an option gives them, then those of --region. */
static void region_materials(const run *r, const sfem_material *all, sfem_material *material)
{
    const int given = ex_given(&r->o, "--young") + ex_given(&r->o, "--poisson");
    sfem_int i;
    int k;
    for (i = 0; i < r->sets.regions; ++i) {
        const sfem_region *g = r->sets.region + i;
        material[i] = *all;
        if (g->has_elastic && !given) material[i].young = g->young, material[i].poisson = g->poisson;
        if (g->has_density && !ex_given(&r->o, "--density")) material[i].density = g->density;
    }
    for (k = 0; k < ex_given(&r->o, "--region"); ++k) {
        const char *text = ex_nth(&r->o, "--region", k), *colon = strrchr(text, ':');
        const sfem_region *g;
        double number[3];
        char name[256];
        if (!colon || colon - text >= (long)sizeof name) ex_fail("--region %s: no NAME:E,NU,RHO", text);
        memcpy(name, text, (size_t)(colon - text));
        name[colon - text] = 0;
        g = sfem_mesh_sets_region(&r->sets, name);
        if (!g) refuse_name(r, "--region", name, 0);
        ex_numbers("--region", colon + 1, 3, number);
        i = (sfem_int)(g - r->sets.region);
        material[i].young = number[0], material[i].poisson = number[1], material[i].density = number[2];
    }
    for (i = 0; i < r->sets.regions; ++i)
        if (r->sets.regions <= 8 || material[i].young != material[0].young)
            printf("region '%s': %ld tets, E %g Pa, nu %g, %g kg/m^3\n", r->sets.region[i].name, (long)r->sets.region[i].tets,
                   material[i].young, material[i].poisson, material[i].density);
}

static void make_model(run *r)
{
    sfem_model_def def = sfem_default_model_def();
    const size_t regions = (size_t)r->sets.regions;
    sfem_material *material = (sfem_material *)ex_new(regions + SFEM_CAGE_LEVELS + 1, sizeof *material);
    sfem_int *index = (sfem_int *)ex_new((size_t)r->mesh.tets, sizeof *index), t, i;
    sfem_error err;
    def.mesh = &r->mesh;
    def.material = material_of_all(r);
    def.mass = ex_choice(&r->o, "--mass") ? SFEM_MASS_CONSISTENT : SFEM_MASS_LUMPED;
    if (r->mesher.size > 0 && ex_given(&r->o, "--cage")) {
        must(sfem_cage_materials(&def.material, 0.05, material, &err), &err);
        def.materials = material;
        def.material_count = SFEM_CAGE_LEVELS + 1;
    } else if (regions > 0 || ex_given(&r->o, "--region")) {
        region_materials(r, &def.material, material);
        for (t = i = 0; t < r->mesh.tets; ++t) {
            if (r->sets.region[i].number != r->mesh.region[t])
                for (i = 0; r->sets.region[i].number != r->mesh.region[t];) ++i;
            index[t] = i;
        }
        def.materials = material;
        def.material_count = r->sets.regions;
        def.tet_material = index;
    }
    must(sfem_model_create(&def, &r->model, &err), &err);
    free(index);
    free(material);
}

/* Which nodes a selection or 'set:NAME' names: a set, the nodes of a set of tets, or those of a region. */
static sfem_int select_nodes(const run *r, const char *option, const char *text, sfem_int *list)
{
    const char *name = text + 4;
    unsigned char *in;
    ex_selection where;
    const sfem_set *nodes, *tets;
    const sfem_region *region;
    sfem_int i, t, count = 0;
    int k;
    in = (unsigned char *)ex_new((size_t)r->mesh.nodes, 1);
    if (strncmp(text, "set:", 4) != 0) {
        where = ex_selection_of(text);
        for (i = 0; i < r->mesh.nodes; ++i) in[i] = (unsigned char)ex_selected(&where, i, r->mesh.x + 3 * (size_t)i);
    } else {
        nodes = sfem_mesh_sets_find(&r->sets, name, 0);
        tets = sfem_mesh_sets_find(&r->sets, name, 1);
        region = sfem_mesh_sets_region(&r->sets, name);
        if (!nodes && !tets && !region) refuse_name(r, option, name, 1);
        for (i = 0; nodes && i < nodes->count; ++i) in[nodes->member[i]] = 1;
        for (i = 0; !nodes && tets && i < tets->count; ++i)
            for (k = 0; k < 4; ++k) in[r->mesh.tet[4 * (size_t)tets->member[i] + (size_t)k]] = 1;
        for (t = 0; !nodes && !tets && t < r->mesh.tets; ++t)
            for (k = 0; k < 4 && r->mesh.region[t] == region->number; ++k) in[r->mesh.tet[4 * (size_t)t + (size_t)k]] = 1;
    }
    for (i = 0; i < r->mesh.nodes; ++i)
        if (in[i]) list[count++] = i;
    free(in);
    if (count == 0) ex_fail("%s %s selects no node", option, text);
    return count;
}

/* Modes in place of the body, held at the same nodes. */
static void make_modal(run *r, const sfem_body_def *body)
{
    sfem_modes_def modes = sfem_default_modes_def();
    sfem_reduced_def reduced = sfem_default_reduced_def();
    sfem_modal_def modal = sfem_default_modal_def();
    double rayleigh[2];
    sfem_error err;
    ex_reals(&r->o, "--rayleigh", 2, rayleigh);
    modes.modes = (sfem_int)ex_count(&r->o, "--modes", 1);
    modes.pins = body->pins;
    modes.pin_count = body->pin_count;
    modes.exec = body->exec;
    must(sfem_modes_create(r->model, &modes, &r->modes, &err), &err);
    reduced.mass_damping = rayleigh[0];
    reduced.stiffness_damping = rayleigh[1];
    reduced.free = body->pin_count == 0;
    must(sfem_reduced_create(r->model, &r->modes, &reduced, &r->reduced, &err), &err);
    must(sfem_reduced_view_create(r->reduced, 0, NULL, SFEM_DOUBLE, &r->view, &err), &err);
    modal.warp = (sfem_warp)ex_choice(&r->o, "--warp"); /* in the order of the enumeration */
    memcpy(modal.gravity, body->gravity, sizeof modal.gravity);
    modal.exec = body->exec;
    modal.max_handle_nodes = r->mesh.nodes;
    must(sfem_modal_create(r->reduced, &modal, &r->modal, &err), &err);
    r->u = (double *)ex_new(6 * (size_t)r->mesh.nodes, sizeof *r->u);
    r->load = r->u + 3 * (size_t)r->mesh.nodes;
    printf("modes: %d, from %.4g to %.4g Hz\n", (int)r->modes.count, sfem_modes_hz(&r->modes, 0),
           sfem_modes_hz(&r->modes, r->modes.count - 1));
}

static const double *displacement(const run *r)
{
    return r->modal ? r->u : sfem_body_displacement(r->body);
}

/* 3. What holds the body. */
static void make_body(run *r)
{
    static const sfem_integrator integrator[] = {
        SFEM_PQR,   SFEM_NEWMARK,        SFEM_CENTRAL, SFEM_KR_ALPHA,          SFEM_GUI,
        SFEM_CHANG, SFEM_BACKWARD_EULER, SFEM_HHT,     SFEM_GENERALIZED_ALPHA, SFEM_BATHE,
        SFEM_PQR};
    sfem_body_def def = sfem_default_body_def();
    sfem_damage_def damage = sfem_default_damage_def();
    sfem_int *pins = (sfem_int *)ex_new((size_t)r->mesh.nodes, sizeof *pins);
    const int given = ex_given(&r->o, "--fix");
    unsigned char *held = (unsigned char *)ex_new((size_t)r->mesh.nodes, 1);
    sfem_int i, k, count;
    sfem_error err;
    for (k = 0; k < (given || ex_text(&r->o, "MESH") ? given : 1); ++k) {
        if (given && !strcmp(ex_nth(&r->o, "--fix", k), "none")) continue;
        count = select_nodes(r, "--fix", given ? ex_nth(&r->o, "--fix", k) : "x<0.01", pins);
        for (i = 0; i < count; ++i) held[pins[i]] = 1;
    }
    for (i = count = 0; i < r->mesh.nodes; ++i)
        if (held[i]) pins[count++] = i;
    def.integrator = integrator[ex_choice(&r->o, "--integrator")];
    def.p = ex_real(&r->o, "--p");
    if (def.integrator == SFEM_NEWMARK && def.p > 0) def.beta = def.p;
    def.frame = (sfem_frame)ex_choice(&r->o, "--frame");
    def.safeguard = !ex_choice(&r->o, "--safeguard");
    def.accuracy = ex_real(&r->o, "--accuracy");
    def.dissipation = ex_real(&r->o, "--dissipation");
    def.newton.iterations = (sfem_int)ex_integer(&r->o, "--newton");
    def.newton.accept_best =
        def.newton.iterations == 1; /* one iteration is never told to converge */
    def.newton.tolerance = ex_real(&r->o, "--tol");
    def.rho_inf = ex_real(&r->o, "--rho-inf");
    def.gui_lambda = ex_real(&r->o, "--gui-lambda");
    def.q = ex_real(&r->o, "--q");
    def.r = ex_real(&r->o, "--r");
    def.precision = ex_choice(&r->o, "--precision") ? SFEM_MIXED : SFEM_DOUBLE;
    ex_reals(&r->o, "--gravity", 3, def.gravity);
    def.exec.threads = (sfem_int)ex_count(&r->o, "--threads", 1);
    def.pins = pins;
    def.pin_count = count;
    def.max_handle_nodes = r->mesh.nodes;
    def.handle_max_force = ex_real(&r->o, "--grip");
    r->breaks = ex_given(&r->o, "--fracture") || ex_given(&r->o, "--strength");
    if (r->breaks && !strcmp(ex_text(&r->o, "--integrator"), "modal"))
        ex_fail("--fracture and --strength: modal bodies do not break");
    if (r->breaks) {
        damage.law = ex_choice(&r->o, "--damage") ? SFEM_DAMAGE_CONDENSED : SFEM_DAMAGE_ZSZ;
        damage.toughness = ex_given(&r->o, "--fracture") ? ex_real(&r->o, "--fracture") : 0;
        if (!ex_given(&r->o, "--fracture")) damage.criterion = SFEM_BREAK_STRESS;
        if (ex_given(&r->o, "--strength"))
            damage.strength = damage.rankine = ex_real(&r->o, "--strength");
        def.damage = &damage;
    }
    must(sfem_body_create(r->model, &def, &r->body, &err), &err);
    printf("body: %d nodes held\n", (int)count);
    if (!strcmp(ex_text(&r->o, "--integrator"), "modal")) make_modal(r, &def);
    free(held);
    free(pins);
}

/* 4. What pulls at it: each load's newtons are shared by its nodes. */
static void add_loads(run *r)
{
    sfem_int *nodes = (sfem_int *)ex_new((size_t)r->mesh.nodes, sizeof *nodes);
    sfem_int i, k, c, count;
    sfem_error err;
    for (k = 0; k < ex_given(&r->o, "--load"); ++k) {
        const char *text = ex_nth(&r->o, "--load", k), *colon = strrchr(text, ':');
        char where[256];
        double force[3];
        sfem_real f[3];
        if (!colon || colon - text >= (long)sizeof where) ex_fail("'%s': no ':FX,FY,FZ' after the selection", text);
        memcpy(where, text, (size_t)(colon - text));
        where[colon - text] = 0;
        ex_numbers("--load", colon + 1, 3, force);
        count = select_nodes(r, "--load", where, nodes);
        for (c = 0; c < 3; ++c) f[c] = force[c] / count;
        for (i = 0; i < count; ++i)
            must(sfem_body_add_lasting_force(r->body, nodes[i], f, &err), &err);
        for (i = 0; i < count && r->modal; ++i) {
            must(sfem_modal_add_lasting_force(r->modal, nodes[i], f, &err), &err);
            for (c = 0; c < 3; ++c) r->load[3 * (size_t)nodes[i] + (size_t)c] += f[c];
        }
    }
    free(nodes);
}

/* '-x=2': the half space beyond it, and the normal towards the body. */
static sfem_obstacle_def read_floor(const char *text, obstacle *o)
{
    const int sign = *text == '-' ? -1 : 1, axis = text[sign < 0] - 'x';
    const char *number = text + (sign < 0) + 1;
    double d;
    if (axis < 0 || axis > 2 || *number != '=') ex_fail("--floor '%s': not as 'z=0' or '-x=2'", text);
    ex_numbers("--floor", number + 1, 1, &d);
    o->normal[axis] = sign;
    o->point[axis] = d;
    return sfem_obstacle_plane(o->normal, o->point);
}

/* 'sphere:X,Y,Z,R' and a velocity, or none. */
static sfem_obstacle_def read_sphere(const char *text, obstacle *o, double *velocity)
{
    sfem_obstacle_def def = sfem_default_obstacle_def();
    double number[7] = {0, 0, 0, 0, 0, 0, 0};
    const char *s;
    int k, count = 1;
    if (strncmp(text, "sphere:", 7) != 0)
        ex_fail("--obstacle '%s': only spheres, 'sphere:X,Y,Z,R'", text);
    for (s = text; *s; ++s) count += *s == ',';
    ex_numbers("--obstacle", text + 7, count == 4 ? 4 : 7, number);
    def.kind = SFEM_OBSTACLE_SPHERE;
    o->sphere = 1;
    o->radius = def.size[0] = number[3];
    for (k = 0; k < 3; ++k) {
        def.position[k] = number[k];
        velocity[k] = number[4 + k];
    }
    return def;
}

/* What it touches. */
static void add_obstacles(run *r)
{
    const int floors = ex_given(&r->o, "--floor"), all = floors + ex_given(&r->o, "--obstacle");
    sfem_contact_surface surface = sfem_default_contact_surface();
    sfem_error err;
    int k;
    if (all == 0) return;
    if (r->modal) ex_fail("--floor and --obstacle are for bodies of nodes: leave out --integrator modal");
    if (all > MAX_OBSTACLES) ex_fail("no more than %d obstacles", MAX_OBSTACLES);
    surface.friction = ex_real(&r->o, "--friction");
    surface.restitution = ex_real(&r->o, "--restitution");
    must(sfem_contact_create(NULL, &r->contact, &err), &err);
    must(sfem_contact_add_body(r->contact, r->body, &surface, ~0u, NULL, &err), &err);
    for (k = 0; k < all; ++k) {
        obstacle *o = r->obstacle + r->obstacles++;
        double velocity[3] = {0, 0, 0};
        sfem_obstacle_def def = k < floors ? read_floor(ex_nth(&r->o, "--floor", k), o)
                                           : read_sphere(ex_nth(&r->o, "--obstacle", k - floors), o, velocity);
        def.contact = surface;
        must(sfem_contact_add_obstacle(r->contact, &def, &o->id, &err), &err);
        must(sfem_contact_move_obstacle(r->contact, o->id, def.position, NULL, velocity, NULL, &err), &err);
    }
}

/* The deepest that any node of the surface is in an obstacle now. */
static double deepest(const run *r)
{
    const sfem_real *u = sfem_body_displacement(r->body);
    double most = 0;
    sfem_int i;
    int k, c;
    for (k = 0; k < r->obstacles; ++k) {
        const obstacle *o = r->obstacle + k;
        double at[3], axes[9];
        sfem_contact_obstacle_pose(r->contact, o->id, at, axes);
        for (i = 0; i < 3 * r->surface.triangles; ++i) {
            const size_t n = 3 * (size_t)r->surface.tri[i];
            double along = 0, square = 0;
            for (c = 0; c < 3; ++c) {
                const double d = r->mesh.x[n + (size_t)c] + u[n + (size_t)c] - at[c];
                along += o->normal[c] * d;
                square += d * d;
            }
            most = fmax(most, o->sphere ? o->radius - sqrt(square) : -along);
        }
    }
    return most;
}

/* Adds one --velocity to v: numbers, or a rotation about the middle of the box, or Gaussian noise. */
static void add_velocity(const run *r, const char *text, double *v)
{
    double lower[3], upper[3], number[3];
    sfem_int i;
    int c;
    ex_bounds(r->mesh.x, r->mesh.nodes, 1, lower, upper);
    if (!strncmp(text, "random:", 7)) {
        uint64_t state;
        ex_numbers("--velocity", text + 7, 2, number);
        if (!(number[1] >= 0 && number[1] < 9e15) || number[1] != floor(number[1]))
            ex_fail("--velocity: the seed %g is not a whole number from 0 to 9e15", number[1]);
        state = (uint64_t)number[1];
        for (i = 0; i < 3 * r->mesh.nodes; ++i) v[i] += number[0] * ex_gauss(&state);
        return;
    }
    ex_numbers("--velocity", !strncmp(text, "spin:", 5) ? text + 5 : text, 3, number);
    for (i = 0; i < 3 * r->mesh.nodes; ++i) {
        if (strncmp(text, "spin:", 5) != 0) {
            v[i] += number[i % 3];
            continue;
        }
        for (c = 1; c < 3; ++c) { /* w x (x - centre), a product at a time */
            const int a = (i % 3 + c) % 3, b = (i % 3 + 3 - c) % 3;
            const double d = r->mesh.x[i - i % 3 + b] - (lower[b] + upper[b]) / 2;
            v[i] += (c == 1 ? 1 : -1) * number[a] * d;
        }
    }
}

/* q' = Phi^T M v, and of a free body the frame's velocities from its momenta. */
static void set_modal_velocity(run *r, const double *v)
{
    const sfem_reduced_info info = sfem_reduced_get_info(r->reduced);
    const sfem_int skip = r->modes.count - info.modes, n = 3 * r->mesh.nodes;
    double *mv = (double *)ex_new((size_t)n, sizeof *mv),
           *q = (double *)ex_new((size_t)info.modes + 1, sizeof *q);
    double momentum[3] = {0, 0, 0}, inertia[9], cofactor[9], determinant = 0;
    sfem_rigid rigid = sfem_modal_rigid(r->modal);
    sfem_error err;
    sfem_int k, i;
    int c;
    sfem_model_multiply_mass(r->model, v, mv, NULL);
    for (k = 0; k < info.modes; ++k)
        for (i = 0; i < n; ++i)
            q[k] += r->modes.phi[(size_t)(k + skip) * (size_t)n + (size_t)i] * mv[i];
    must(sfem_modal_set_coordinates(r->modal, NULL, q, NULL, &err), &err);
    for (i = 0; i < n; ++i) {
        const int a = (i % 3 + 1) % 3, b = (i % 3 + 2) % 3;
        const double *x = info.x + i - i % 3, *p = mv + i - i % 3;
        rigid.v[i % 3] += mv[i] / info.mass;
        momentum[i % 3] += (x[a] - info.centre[a]) * p[b] - (x[b] - info.centre[b]) * p[a];
    }
    memcpy(inertia, info.inertia, sizeof inertia);
    for (c = 0; c < 9; ++c) { /* the inverse by cofactors */
        const int i1 = (c / 3 + 1) % 3, i2 = (c / 3 + 2) % 3, j1 = (c + 1) % 3, j2 = (c + 2) % 3;
        cofactor[c] = inertia[3 * i1 + j1] * inertia[3 * i2 + j2] -
                      inertia[3 * i1 + j2] * inertia[3 * i2 + j1];
        if (c < 3) determinant += inertia[c] * cofactor[c];
    }
    for (c = 0; c < 9; ++c) rigid.w[c / 3] += cofactor[c] / determinant * momentum[c % 3];
    if (info.free) must(sfem_modal_set_rigid(r->modal, &rigid, &err), &err);
    free(q);
    free(mv);
}

static void set_velocity(run *r)
{
    double *v = (double *)ex_new(3 * (size_t)r->mesh.nodes, sizeof *v);
    sfem_error err;
    int k;
    for (k = 0; k < ex_given(&r->o, "--velocity"); ++k)
        add_velocity(r, ex_nth(&r->o, "--velocity", k), v);
    if (k > 0) must(sfem_body_set_state(r->body, NULL, v, &err), &err);
    if (k > 0 && r->modal) set_modal_velocity(r, v);
    free(v);
}

/* A hand: the nodes of a patch of the surface, by smooth weights. */
static void take_hold(run *r)
{
    sfem_int *node, count, k;
    double *weight, where[4], most = 0;
    sfem_patch patch;
    sfem_error err;
    int near = 0;
    r->hand = -1;
    if (!ex_given(&r->o, "--grab")) return;
    node = (sfem_int *)ex_new((size_t)r->mesh.nodes, sizeof *node);
    weight = (double *)ex_new((size_t)r->mesh.nodes, sizeof *weight);
    ex_reals(&r->o, "--grab", 4, where);
    memset(&patch, 0, sizeof patch);
    memcpy(patch.point, where, sizeof patch.point);
    patch.radius = where[3];
    patch.surface = &r->surface;
    must(sfem_mesh_near(&r->mesh, &patch, r->mesh.nodes, node, weight, &count, &err), &err);
    for (k = 0; k < count; ++k) {
        const sfem_real *x = r->mesh.x + 3 * (size_t)node[k];
        most = fmax(most, weight[k]);
        near = near || hypot(hypot(x[0] - where[0], x[1] - where[1]), x[2] - where[2]) <= where[3];
    }
    if (!near) ex_fail("--grab: no node of the surface is within %g m of %g,%g,%g", where[3], where[0], where[1], where[2]);
    if (r->modal) {
        must(sfem_modal_grab_region(r->modal, count, node, weight, &r->hand, &err), &err);
        sfem_modal_handle_position(r->modal, r->hand, r->held);
    } else {
        must(sfem_body_grab_region(r->body, count, node, weight, &r->hand, &err), &err);
        sfem_body_handle_position(r->body, r->hand, r->held);
    }
    printf("handle: %d nodes about %.3g %.3g %.3g m, each with at most %.2g of its force\n",
           (int)count, r->held[0], r->held[1], r->held[2], most);
    free(node);
    free(weight);
}

/* Where the hand is to be at the end of the next step. */
static void move_hand(run *r, double time)
{
    double v[3], x[3];
    sfem_error err;
    int c;
    if (r->hand < 0) return;
    ex_reals(&r->o, "--pull", 3, v);
    for (c = 0; c < 3; ++c) x[c] = r->held[c] + time * v[c];
    if (r->modal)
        must(sfem_modal_move_handle(r->modal, r->hand, x, &err), &err);
    else
        must(sfem_body_move_handle(r->body, r->hand, x, &err), &err);
}

static double length3(const double *a) { return sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2]); }

static double largest_displacement(const run *r)
{
    const sfem_real *u = displacement(r);
    double most = 0;
    sfem_int i;
    for (i = 0; i < r->mesh.nodes; ++i) most = fmax(most, length3(u + 3 * (size_t)i));
    return most;
}

/* The node that is plotted: the one asked for, else the one farthest from the middle of what is held. */
static void choose_probe(run *r)
{
    double lower[3], upper[3], most = -1;
    sfem_int i;
    int c;
    r->probe = (sfem_int)ex_count(&r->o, "--probe", -1);
    if (r->probe >= r->mesh.nodes)
        ex_fail("--probe %d: the mesh has %d nodes", (int)r->probe, (int)r->mesh.nodes);
    if (r->probe >= 0) return;
    ex_bounds(r->mesh.x, r->mesh.nodes, 1, lower, upper);
    for (i = 0; i < r->mesh.nodes; ++i) {
        double d[3];
        for (c = 0; c < 3; ++c) d[c] = r->mesh.x[3 * (size_t)i + (size_t)c] - lower[c];
        if (length3(d) <= most) continue;
        most = length3(d);
        r->probe = i;
    }
}

static double when_is_it(const run *r)
{
    return r->modal ? sfem_modal_time(r->modal) : sfem_body_time(r->body);
}

static void positions(const run *r, double *x)
{
    sfem_int i;
    for (i = 0; i < 3 * r->mesh.nodes; ++i) x[i] = r->mesh.x[i] + displacement(r)[i];
}

static sfem_energy energy(const run *r)
{
    sfem_energy e;
    sfem_modal_info info;
    double g[3];
    sfem_int i;
    if (!r->modal) return sfem_body_energy(r->body);
    memset(&e, 0, sizeof e);
    info = sfem_modal_get_info(r->modal);
    ex_reals(&r->o, "--gravity", 3, g);
    e.kinetic = info.kinetic;
    e.elastic = info.elastic;
    for (i = 0; i < 3 * r->mesh.nodes; ++i)
        e.load -= r->u[i] * (r->load[i] + g[i % 3] * sfem_model_node_mass(r->model)[i / 3]);
    e.total = e.kinetic + e.elastic + e.load;
    return e;
}

static void rest(run *r)
{
    sfem_error err;
    if (!r->modal) {
        must(sfem_body_solve_static(r->body, &err), &err);
        return;
    }
    must(sfem_modal_solve_static(r->modal, NULL, &err), &err);
    sfem_modal_displacements(r->modal, r->view, r->u);
}

static void step(run *r)
{
    sfem_error err;
    move_hand(r, when_is_it(r) + r->h);
    if (r->contact) {
        must(sfem_contact_step(r->contact, r->h, &err), &err);
        r->penetration = fmax(r->penetration, deepest(r));
        return;
    }
    if (!r->modal) {
        must(sfem_body_step(r->body, r->h, &err), &err);
        return;
    }
    must(sfem_modal_step(r->modal, r->h, &err), &err);
    sfem_modal_displacements(r->modal, r->view, r->u);
}

/* The surface triangles that no break has parted, for frame k. */
static void keep_whole(run *r, int k)
{
    sfem_int i;
    int c;
    r->whole[k] = (int32_t *)ex_new(3 * (size_t)r->surface.triangles, sizeof(int32_t));
    for (i = 0; i < r->surface.triangles; ++i) {
        const sfem_int *t = r->surface.tri + 3 * (size_t)i;
        int whole = 1;
        for (c = 0; c < 3; ++c) whole &= sfem_body_edge_left(r->body, t[c], t[(c + 1) % 3]) > 0;
        if (whole) memcpy(r->whole[k] + 3 * (size_t)r->wholes[k]++, t, 3 * sizeof *t);
    }
}

static void keep_look(run *r, look *out)
{
    sfem_embed_pieces pieces;
    sfem_error err;
    const sfem_int *tri = r->render.tri;
    memset(&pieces, 0, sizeof pieces);
    out->nodes = r->render.nodes;
    out->outer = r->render.triangles;
    if (r->breaks) {
        must(sfem_embed_break(r->embed, r->body, NULL, &pieces, &err), &err);
        tri = pieces.tri;
        out->nodes = pieces.vertices;
        out->outer = pieces.triangles - pieces.inner;
        out->inner = pieces.inner;
    }
    out->x = (double *)ex_new(3 * (size_t)out->nodes, sizeof *out->x);
    out->tri = (int32_t *)ex_new(3 * (size_t)(out->outer + out->inner), sizeof *out->tri);
    memcpy(out->tri, tri, 3 * (size_t)(out->outer + out->inner) * sizeof *tri);
    if (r->breaks)
        sfem_embed_pieces_positions(r->embed, &pieces, r->body, out->x, NULL);
    else
        sfem_embed_positions(r->embed, displacement(r), out->x, NULL);
    sfem_embed_pieces_free(&pieces);
}

static void record(run *r, sfem_int step)
{
    const sfem_energy e = energy(r);
    r->time[step] = when_is_it(r);
    r->tip[step] = displacement(r)[3 * (size_t)r->probe + 2];
    r->energy[0][step] = e.kinetic;
    r->energy[1][step] = e.elastic;
    r->energy[2][step] = e.total;
    if (r->frames < FRAMES && step >= r->steps * r->frames / (FRAMES - 1)) {
        r->frame[r->frames] = (double *)ex_new(3 * (size_t)r->mesh.nodes, sizeof(double));
        r->frame_time[r->frames] = r->time[step];
        if (r->breaks) keep_whole(r, r->frames);
        if (r->embed) keep_look(r, r->look + r->frames);
        positions(r, r->frame[r->frames++]);
    }
}

static void write_step(run *r, const char *path)
{
    double *x = (double *)ex_new(3 * (size_t)r->mesh.nodes, sizeof *x), *stress;
    sfem_field field[2];
    sfem_error err;
    positions(r, x);
    stress = ex_tet_stress(r->model, &r->mesh, x);
    memset(field, 0, sizeof field);
    field[0].name = "displacement";
    field[0].values = displacement(r);
    field[0].components = 3;
    field[1].name = "von_mises";
    field[1].values = stress;
    field[1].components = 1;
    field[1].per_tet = 1;
    must(sfem_mesh_write_vtu(path, &r->mesh, x, field, 2, &err), &err);
    free(stress);
    free(x);
}

/* 5. Rest, or steps through time. */
static void simulate(run *r)
{
    const sfem_int every = (sfem_int)ex_count(&r->o, "--vtu", 0);
    char(*name)[32] = (char(*)[32])ex_new((size_t)r->steps + 1, sizeof *name);
    const char **file = (const char **)ex_new((size_t)r->steps + 1, sizeof *file);
    double *when = (double *)ex_new((size_t)r->steps + 1, sizeof *when), start;
    sfem_int i, files = 0;
    sfem_error err;
    start = ex_seconds();
    if (r->steps == 0)
        rest(r);
    else if (!r->modal)
        must(sfem_body_prepare(r->body, r->h, &err), &err);
    r->setup += ex_seconds() - start;
    record(r, 0);
    for (i = 0; i <= r->steps; ++i) {
        if (i > 0) {
            start = ex_seconds();
            step(r);
            r->stepping += ex_seconds() - start;
            record(r, i);
        }
        if (every > 0 && i % every == 0) {
            snprintf(name[files], sizeof *name, "step%06d.vtu", (int)i);
            write_step(r, ex_path(ex_text(&r->o, "--out"), name[files]));
            file[files] = name[files];
            when[files++] = when_is_it(r);
        }
        ex_progress("simulate", i, r->steps);
    }
    if (files)
        must(sfem_mesh_write_pvd(ex_path(ex_text(&r->o, "--out"), "steps.pvd"), file, when, files,
                                 &err),
             &err);
    free(when);
    free(file);
    free(name);
}

static void draw_look(ex_picture *p, const look *l)
{
    ex_style style = ex_default_style();
    style.edges = 0;
    ex_view_surface(p, l->nodes, l->x, l->outer, l->tri, NULL, &style);
    style.color[0] = 0.85; /* inner faces: as they are, in another colour */
    style.color[1] = 0.62;
    style.color[2] = 0.42;
    style.flat = 1;
    ex_view_surface(p, l->nodes, l->x, l->inner, l->tri + 3 * (size_t)l->outer, NULL, &style);
}

static void draw(const run *r)
{
    const double direction[3] = {0.35, -1, 0.3};
    const int across = r->frames > 1 ? 3 : 1, down = (r->frames + across - 1) / across;
    ex_picture *p = ex_picture_new(across > 1 ? 1500 : 1000, across > 1 ? 420 * down : 700);
    ex_style style = ex_default_style();
    double lower[3] = {0, 0, 0}, upper[3] = {0, 0, 0}, low, high;
    double *value[FRAMES];
    int k;
    p->bar = !r->breaks && !r->embed;
    for (k = 0; k < r->frames; ++k) {
        ex_bounds(r->frame[k], r->mesh.nodes, k == 0, lower, upper);
        if (r->embed) ex_bounds(r->look[k].x, r->look[k].nodes, 0, lower, upper);
        value[k] = ex_node_stress(r->model, &r->mesh, r->frame[k]);
        ex_range(value[k], r->mesh.nodes, &low, &high);
        style.high = fmax(style.high * (k > 0), high);
    }
    style.low = 0;
    for (k = 0; k < r->frames; ++k) {
        char caption[64];
        ex_view_begin(p, k, across, down, lower, upper, direction);
        if (r->embed)
            draw_look(p, r->look + k);
        else if (r->breaks) /* stresses across cracks would be those of whole tets */
            ex_view_surface(p, r->mesh.nodes, r->frame[k], r->wholes[k], r->whole[k], NULL, &style);
        else
            ex_view_surface(p, r->mesh.nodes, r->frame[k], r->surface.triangles, r->surface.tri,
                            value[k], &style);
        snprintf(caption, sizeof caption, r->frames > 1 ? "t = %.3g s" : "at rest",
                 r->frame_time[k]);
        ex_view_end(p, caption);
        free(value[k]);
    }
    if (p->bar) ex_colorbar(p, "stress, Pa", 0, style.high);
    ex_picture_write(p, ex_path(ex_text(&r->o, "--out"), "body.png"));
    ex_picture_free(p);
}

static void plot(const run *r)
{
    ex_plot motion = ex_plot_new("Displacement", "time, s", "displacement along z, m", 0);
    ex_plot energy = ex_plot_new("Energy", "time, s", "energy, J", 0);
    char name[32];
    snprintf(name, sizeof name, "node %d", (int)r->probe);
    ex_plot_add(&motion, name, r->time, r->tip, r->steps + 1, EX_LINE);
    ex_plot_write(&motion, ex_path(ex_text(&r->o, "--out"), "motion.svg"));
    ex_plot_add(&energy, "kinetic", r->time, r->energy[0], r->steps + 1, EX_LINE);
    ex_plot_add(&energy, "elastic", r->time, r->energy[1], r->steps + 1, EX_LINE);
    ex_plot_add(&energy, "total, with the loads'", r->time, r->energy[2], r->steps + 1, EX_LINE);
    ex_plot_write(&energy, ex_path(ex_text(&r->o, "--out"), "energy.svg"));
}

static void write_csv(const run *r, const char *path)
{
    const sfem_real *u = displacement(r);
    FILE *f = ex_open(path);
    sfem_int i;
    fprintf(f, "node,ux,uy,uz\n");
    for (i = 0; i < r->mesh.nodes; ++i, u += 3)
        fprintf(f, "%d,%.17g,%.17g,%.17g\n", (int)i, u[0], u[1], u[2]);
    ex_close(f, path);
}

/* 6. Figures, files. */
static void report(run *r)
{
    const sfem_body_info info = sfem_body_get_info(r->body);
    const char *out = ex_text(&r->o, "--out");
    if (r->steps > 0) plot(r);
    draw(r);
    if (ex_text(&r->o, "--csv")) write_csv(r, ex_text(&r->o, "--csv"));
    printf("wrote %s/body.png%s\n", out, r->steps > 0 ? ", motion.svg, energy.svg" : "");
    if (ex_integer(&r->o, "--probe") >= 0) {
        const sfem_real *u = displacement(r) + 3 * (size_t)r->probe;
        printf("probe %d %.17g %.17g %.17g\n", (int)r->probe, u[0], u[1], u[2]);
    }
    printf("nodes %d\ntets %d\ndofs %d\n", (int)info.nodes, (int)info.tets,
           3 * (int)info.free_nodes);
    printf("nnz_factor %lu\n", (unsigned long)info.factor_nnz);
    printf("setup_ms %.3f\n", 1e3 * r->setup);
    printf("step_us %.3f\n", r->steps > 0 ? 1e6 * r->stepping / r->steps : 0);
    printf("rejected %ld\nsolves %ld\n", (long)info.rejected, (long)info.solves);
    if (r->breaks) {
        const sfem_fracture f = sfem_body_fracture(r->body);
        printf("pieces %d\nbroken_edges %d\nenergy_error %.3g\n", (int)f.pieces, (int)f.broken,
               f.scale > 0 ? fabs(f.error) / f.scale : 0.0);
    }
    if (r->contact) {
        const sfem_contact_info c = sfem_contact_get_info(r->contact);
        printf("contacts %d\npenetration %.3g\ncontact_work %.9g\n", (int)c.contacts, r->penetration, c.work);
    }
    printf("energy %.17g\n", energy(r).total);
    printf("max_displacement %.17g\n", largest_displacement(r));
}

int main(int argc, char **argv)
{
    run r;
    double start;
    int k;
    memset(&r, 0, sizeof r);
    r.o = ex_parse(argc, argv, "Simulates an elastic body and draws it.", table);
    r.h = ex_real(&r.o, "--dt");
    r.steps = (sfem_int)ex_count(&r.o, "--steps", 1);
    if (r.steps > MAX_STEPS) ex_fail("--steps must be at most %d", MAX_STEPS);
    if (ex_given(&r.o, "--quick") && r.steps > 12) r.steps = 12;
    if (ex_given(&r.o, "--static")) r.steps = 0;
    if (ex_given(&r.o, "--static") && (ex_given(&r.o, "--floor") || ex_given(&r.o, "--obstacle")))
        ex_fail("--static sees no obstacles: leave out --floor and --obstacle, or let the body step until it rests, damped by --rayleigh");
    ex_make_directory(ex_text(&r.o, "--out"));
    read_mesh(&r);
    read_surface(&r);
    start = ex_seconds();
    make_model(&r);
    make_body(&r);
    r.setup = ex_seconds() - start;
    add_loads(&r);
    take_hold(&r);
    set_velocity(&r);
    add_obstacles(&r);
    choose_probe(&r);
    r.time = (double *)ex_new(5 * ((size_t)r.steps + 1), sizeof *r.time);
    r.tip = r.time + r.steps + 1;
    for (k = 0; k < 3; ++k) r.energy[k] = r.tip + (k + 1) * (r.steps + 1);
    simulate(&r);
    report(&r);
    for (k = 0; k < r.frames; ++k) {
        free(r.frame[k]);
        free(r.whole[k]);
        free(r.look[k].x);
        free(r.look[k].tri);
    }
    free(r.time);
    free(r.u);
    sfem_contact_free(r.contact);
    sfem_modal_free(r.modal);
    sfem_reduced_view_free(r.view);
    sfem_reduced_free(r.reduced);
    sfem_modes_free(&r.modes);
    sfem_body_free(r.body);
    sfem_model_free(r.model);
    sfem_embed_free(r.embed);
    sfem_surface_free(&r.render);
    sfem_surface_free(&r.surface);
    sfem_mesh_sets_free(&r.sets);
    sfem_mesh_free(&r.mesh);
    return 0;
}
