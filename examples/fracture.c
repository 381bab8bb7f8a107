/* fracture - four bodies that break along the edges of their meshes.
 *
 *      bend          tensile              plate               blade
 *       v                                   |  a handle           |
 *     =======     <- ====--==== ->      ----v----                (|)
 *      ^   ^
 *
 *     fracture --scene bend      a notched bar on two supports, pressed in the middle
 *     fracture --scene tensile   a bar pulled until it necks and breaks: ductile
 *     fracture --scene plate     a held plate, struck; its fragments fly
 *     fracture --scene blade     a spinning ball, cut in two
 *
 * One factor of the intact body serves from beginning to end [softfem.h, >>damage]. Leaves pictures, energies
 * and load-displacement curves in the --out directory. The last lines of each scene are `key value`:
 * griffith_ratio is the bar's largest load over the one at which its crack advances by Griffith's theory;
 * energy_error is what elastic, kinetic and released energy, damping and work leave over, over the largest of
 * them.
 */
#include "support.h"
#include "softfem.h"

enum { FRAMES = 4, SCENES = 4, BEND = 0, TENSILE, PLATE, BLADE };

static const ex_option table[] = {
    {"--scene", "bend|tensile|plate|blade|all", "all", "what breaks"},
    {"--toughness", "GC", NULL, "J/m^2, instead of the scene's own"},
    {"--dt", "H", NULL, "time step, s, instead of the scene's own"},
    {"--accuracy", "A", "1e-6",
     "corrections stop below this part of the energy in motion; 1: one solve a step"},
    {"--dissipation", "ALPHA", NULL, "0 to 1/3: damps what a step does not resolve, instead of the scene's own"},
    {"--damage", "zsz|condensed", "condensed", "the law of damaged tets"},
    {"--refactorise", "X", "0", "work a step on a new factor after breaks, in steps of one solve"},
    {"--threads", "N", "1", "threads"},
    {"--out", "DIR", "build/fracture", "where files go"},
    {"--quick", NULL, NULL, "a small run: coarse meshes"},
    {NULL, NULL, NULL, NULL}};

static const char *const name[SCENES] = {"bend", "tensile", "plate", "blade"};

typedef struct picture {
    sfem_fragments surface;
    double *x;
    char caption[64];
} picture;

typedef struct run {
    ex_options o;
    int scene, quick;
    sfem_mesh mesh;
    sfem_model *model;
    sfem_body *body;
    sfem_damage_def damage;
    sfem_int steps, moved_count, *moved; /* pins that move */
    sfem_int handle[64], handles;
    double h, blade[9];
    double *time, *way, *load, *energy[5]; /* [steps] */
    picture frame[FRAMES];
    int frames;
    double shot[FRAMES]; /* when, in parts of the run */
} run;

static void must(sfem_status status, const sfem_error *err)
{
    if (status != SFEM_OK) ex_fail("%s", err->text);
}

/* 1. The meshes. */
static void block(run *r, sfem_int nx, sfem_int ny, sfem_int nz, double x, double y, double z)
{
    const double size[3] = {x, y, z};
    sfem_int cells[3];
    sfem_error err;
    cells[0] = nx, cells[1] = ny, cells[2] = nz;
    must(sfem_mesh_block(cells, size, SFEM_CELL_5_TETS, NULL, &r->mesh, &err), &err);
}

/* Inner nodes a little out of place, so that cracks do not follow the cells. */
static void jitter(run *r, const double size[3], double by)
{
    uint64_t state = 4;
    sfem_int i;
    int c;
    for (i = 0; i < r->mesh.nodes; ++i)
        for (c = 0; c < 3; ++c) {
            double *x = r->mesh.x + 3 * (size_t)i + c;
            const double d = by * ex_clamp(ex_gauss(&state), -1.5, 1.5);
            if (*x > 1e-9 && *x < size[c] - 1e-9) *x += d;
        }
}

static void make_mesh(run *r)
{
    const int q = r->quick;
    sfem_error err;
    sfem_int i;
    if (r->scene == BEND) {
        const double size[3] = {1, 0.12, 0.25};
        block(r, q ? 17 : 41, q ? 2 : 5, q ? 5 : 10, size[0], size[1], size[2]);
        jitter(r, size, q ? 0.006 : 0.003);
    } else if (r->scene == TENSILE) {
        const double size[3] = {1, 0.2, 0.2};
        block(r, q ? 14 : 32, q ? 3 : 6, q ? 3 : 6, size[0], size[1], size[2]);
        for (i = 0; i < r->mesh.nodes; ++i) { /* narrower in the middle */
            double *x = r->mesh.x + 3 * (size_t)i;
            const double part = 1 - 0.35 * exp(-pow(fabs(x[0] - 0.5) / 0.22, 4));
            x[1] = 0.1 + part * (x[1] - 0.1);
            x[2] = 0.1 + part * (x[2] - 0.1);
        }
    } else if (r->scene == PLATE) {
        const double size[3] = {1, 1, 0.05};
        block(r, q ? 10 : 30, q ? 10 : 30, q ? 1 : 2, size[0], size[1], size[2]);
        jitter(r, size, q ? 0.012 : 0.005);
    } else {
        must(sfem_mesh_ball(0.5, q ? 4 : 9, NULL, &r->mesh, &err), &err);
    }
}

/* 2. Material and damage. */
static void make_model(run *r)
{
    sfem_model_def def = sfem_default_model_def();
    sfem_error err;
    def.mesh = &r->mesh;
    def.material.law = r->scene == BEND ? SFEM_LINEAR : SFEM_COROTATIONAL;
    def.material.young = r->scene == BEND      ? 2e6
                         : r->scene == TENSILE ? 1e6
                         : r->scene == PLATE   ? 5e6
                                               : 2e5;
    def.material.mass_damping = r->scene == BEND ? 4 : r->scene == TENSILE ? 1 : 0.1;
    def.material.stiffness_damping = r->scene == TENSILE ? 0.004 : 0;
    must(sfem_model_create(&def, &r->model, &err), &err);
    r->damage = sfem_default_damage_def();
    r->damage.law = ex_choice(&r->o, "--damage") ? SFEM_DAMAGE_CONDENSED : SFEM_DAMAGE_ZSZ;
    r->damage.toughness = r->scene == BEND ? 20 : r->scene == PLATE ? 15 : 50;
    if (r->scene == TENSILE) {
        r->damage.criterion = SFEM_BREAK_DUCTILE;
        r->damage.soften[0] = 0.05;
        r->damage.soften[1] = 0.45;
    }
    r->damage.corrected = 1;
    if (r->scene == PLATE) r->damage.weibull = 8;
    if (ex_given(&r->o, "--toughness")) r->damage.toughness = ex_real(&r->o, "--toughness");
}

/* Pins all nodes that `where` selects, and remembers them as moving. */
static void pin(run *r, const char *where, unsigned char axes, int moves, sfem_int *pins,
                unsigned char *held, sfem_int *count)
{
    const ex_selection selection = ex_selection_of(where);
    sfem_int i;
    for (i = 0; i < r->mesh.nodes; ++i) {
        if (!ex_selected(&selection, i, r->mesh.x + 3 * (size_t)i)) continue;
        held[*count] = axes;
        pins[(*count)++] = i;
        if (moves) r->moved[r->moved_count++] = i;
    }
}

/* The notch of the bar, between two rows of nodes: then its front is where the blade stops. */
static double notch(const run *r)
{
    return r->quick ? 0.075 : 0.0625;
}

/* The load of a bar on two supports at which the crack advances, K^2 (1 - nu^2) = E Gc in plane strain
 * [Srawley 1976, within 0.5 % for spans of four times the height]. */
static double griffith(const run *r)
{
    const double height = 0.25, thickness = 0.12, span = r->quick ? 13 / 17.0 : 33 / 41.0, young = 2e6, nu = 0.3;
    const double a = notch(r) / height;
    const double f = 3 * sqrt(a) * (1.99 - a * (1 - a) * (2.15 - 3.93 * a + 2.7 * a * a)) /
                     (2 * (1 + 2 * a) * pow(1 - a, 1.5));
    return sqrt(young * r->damage.toughness / (1 - nu * nu)) * thickness * pow(height, 1.5) / (span * f);
}

/* 3. What holds it, and how it starts. */
static void make_body(run *r)
{
    sfem_body_def def = sfem_default_body_def();
    sfem_int *pins = (sfem_int *)ex_new(2 * (size_t)r->mesh.nodes, sizeof *pins), count = 0, i;
    unsigned char *held = (unsigned char *)ex_new(2 * (size_t)r->mesh.nodes, 1);
    sfem_error err;
    r->moved = (sfem_int *)ex_new((size_t)r->mesh.nodes, sizeof *r->moved);
    if (r->scene == BEND) {
        pin(r, r->quick ? "x>0.09 & x<0.15 & z=0" : "x>0.08 & x<0.11 & z=0", SFEM_AXIS_ALL, 0, pins,
            held, &count);
        pin(r, r->quick ? "x>0.85 & x<0.91 & z=0" : "x>0.89 & x<0.92 & z=0",
            SFEM_AXIS_Y | SFEM_AXIS_Z, 0, pins, held, &count);
        pin(r, r->quick ? "x>0.45 & x<0.55 & z=0.25" : "x>0.475 & x<0.525 & z=0.25", SFEM_AXIS_Z, 1,
            pins, held, &count);
    } else if (r->scene == TENSILE) {
        pin(r, "x=0", SFEM_AXIS_ALL, 0, pins, held, &count);
        pin(r, "x=1", SFEM_AXIS_ALL, 1, pins, held, &count);
    } else if (r->scene == PLATE) {
        pin(r, "x=0 | x=1 | y=0 | y=1", SFEM_AXIS_ALL, 0, pins, held, &count);
    }
    def.pins = pins;
    def.pin_axes = held;
    def.pin_count = count;
    def.damage = &r->damage;
    def.max_handles = 64;
    def.refactorise = ex_real(&r->o, "--refactorise");
    def.exec.threads = (sfem_int)ex_count(&r->o, "--threads", 1);
    if (r->scene == PLATE) def.gravity[2] = -9.81;
    def.accuracy = ex_real(&r->o, "--accuracy");
    if (r->scene == BEND || r->scene == PLATE) def.dissipation = 0; /* what breaks sets free would go there */
    if (ex_given(&r->o, "--dissipation")) def.dissipation = ex_real(&r->o, "--dissipation");
    must(sfem_body_create(r->model, &def, &r->body, &err), &err);
    if (r->scene == BEND) { /* the notch: a blade that comes from below */
        const double from[9] = {0.49, -1, -0.1, 0.51, -1, -0.1, 0.5, 1, -0.1};
        double to[9];
        memcpy(to, from, sizeof to);
        for (i = 2; i < 9; i += 3) to[i] = notch(r);
        must(sfem_body_cut(r->body, from, to, NULL, &err), &err);
    }
    if (r->scene == BLADE) { /* it spins about an axis in the plane of the cut */
        double *v = (double *)ex_new(3 * (size_t)r->mesh.nodes, sizeof *v);
        for (i = 0; i < r->mesh.nodes; ++i) {
            const double *x = r->mesh.x + 3 * (size_t)i;
            v[3 * i] = 2 * x[2];
            v[3 * i + 2] = -2 * x[0];
        }
        must(sfem_body_set_state(r->body, NULL, v, &err), &err);
        free(v);
    }
    free(held);
    free(pins);
}

/* How far the bar is pressed at t, m: softly at first, so that it does not swing; slowly, until the crack has run; then
 * faster, until the bar parts. */
static double pressed(double t)
{
    return 0.012 * (t > 0.4 ? t - 0.2 : t * t / 0.8) + (t > 0.8 ? 0.3 * (t - 0.8) * (t - 0.8) : 0);
}

/* 4. What acts during step k. */
static void drive(run *r, sfem_int k)
{
    const double t = r->h * (double)(k + 1);
    sfem_error err;
    sfem_int i;
    int c;
    for (i = 0; i < r->moved_count; ++i) {
        const double *x = r->mesh.x + 3 * (size_t)r->moved[i];
        double to[3];
        for (c = 0; c < 3; ++c) to[c] = x[c];
        r->way[k] = r->scene == BEND ? pressed(t) : 0.35 * t;
        to[r->scene == BEND ? 2 : 0] += r->scene == BEND ? -r->way[k] : r->way[k];
        must(sfem_body_move_pin(r->body, r->moved[i], to, &err), &err);
    }
    if (r->scene == PLATE) { /* a hammer: handles that go down at 4 m/s, and let go */
        const double down = 4 * t;
        if (k == 0)
            for (i = 0; i < r->mesh.nodes && r->handles < 64; ++i) {
                const double *x = r->mesh.x + 3 * (size_t)i;
                if (x[2] > 0.049 && hypot(x[0] - 0.45, x[1] - 0.55) < (r->quick ? 0.1 : 0.06))
                    must(sfem_body_grab_node(r->body, i, &r->handle[r->handles++], &err), &err);
            }
        if (down > 0.12 && r->handles) {
            for (i = 0; i < r->handles; ++i) sfem_body_release_handle(r->body, r->handle[i]);
            r->handles = 0;
        }
        r->way[k] = r->handles ? down : r->way[k ? k - 1 : 0];
        for (i = 0; i < r->handles; ++i) {
            double x[3];
            sfem_body_handle_position(r->body, r->handle[i], x);
            x[2] -= 4 * r->h;
            must(sfem_body_move_handle(r->body, r->handle[i], x, &err), &err);
        }
    }
    if (r->scene == BLADE) { /* a wire, from above, 4 m/s */
        double from[9] = {0.029, -1, 0, 0.031, -1, 0, 0.03, 1, 0}, to[9];
        memcpy(to, from, sizeof to);
        for (i = 2; i < 9; i += 3) {
            from[i] = 0.6 - 4 * (t - 2 * r->h); /* overlapping: the ball rotates meanwhile */
            to[i] = 0.6 - 4 * t;
        }
        if (to[2] > -0.7) must(sfem_body_cut(r->body, from, to, NULL, &err), &err);
        r->way[k] = 4 * t;
    }
}

/* The force that presses, pulls or strikes. */
static double load(run *r)
{
    double sum = 0, force[3], *all;
    sfem_int i;
    for (i = 0; i < r->handles; ++i) {
        sfem_body_handle_force(r->body, r->handle[i], force);
        sum -= force[2];
    }
    if (!r->moved_count) return sum;
    all = (double *)ex_new(3 * (size_t)r->mesh.nodes, sizeof *all);
    sfem_body_reactions(r->body, all);
    for (i = 0; i < r->moved_count; ++i)
        sum += r->scene == BEND ? -all[3 * r->moved[i] + 2] : all[3 * r->moved[i]];
    free(all);
    return sum;
}

static void photograph(run *r, double t)
{
    picture *p = &r->frame[r->frames++];
    sfem_error err;
    const sfem_fracture f = sfem_body_fracture(r->body);
    must(sfem_body_fragments(r->body, NULL, &p->surface, &err), &err);
    p->x = (double *)ex_new(3 * (size_t)p->surface.vertices, sizeof *p->x);
    sfem_body_fragment_positions(r->body, &p->surface, p->x);
    snprintf(p->caption, sizeof p->caption, "%.3g s: %d piece%s, %d edges broken", t, (int)f.pieces,
             f.pieces == 1 ? "" : "s", (int)f.broken);
}

static void simulate(run *r)
{
    sfem_error err;
    sfem_int k;
    int c;
    for (k = 0; k < r->steps; ++k) {
        sfem_fracture f;
        drive(r, k);
        must(sfem_body_step(r->body, r->h, &err), &err);
        f = sfem_body_fracture(r->body);
        r->time[k] = sfem_body_time(r->body);
        r->load[k] = load(r);
        r->energy[0][k] = f.kinetic_elastic - f.start;
        r->energy[1][k] = f.work;
        r->energy[2][k] = f.released;
        r->energy[3][k] = f.damped;
        r->energy[4][k] = f.error;
        for (c = r->frames; c < FRAMES; c = FRAMES)
            if (k + 1 >= r->shot[c] * r->steps) photograph(r, r->time[k]);
        ex_progress(name[r->scene], k + 1, r->steps);
    }
}

/* 5. Pictures and plots. */
static void draw_part(ex_picture *p, const picture *f, int made, const double *color)
{
    ex_style style = ex_default_style();
    int32_t *tri = (int32_t *)ex_new(3 * (size_t)f->surface.triangles, sizeof *tri);
    sfem_int i, count = 0;
    int c;
    for (i = 0; i < f->surface.triangles; ++i)
        for (c = 0; f->surface.made[i] == made && c < 3; ++c)
            tri[count++] = f->surface.tri[3 * i + c];
    memcpy(style.color, color, sizeof style.color);
    style.edges = 0;
    style.flat = made;
    ex_view_surface(p, f->surface.vertices, f->x, count / 3, tri, NULL, &style);
    free(tri);
}

static void draw(run *r)
{
    static const double from[SCENES][3] = {
        {0.35, -1, 0.25}, {0.3, -1, 0.35}, {0.5, -1, 0.75}, {0.9, -1, 0.4}};
    static const double outer[3] = {0.50, 0.62, 0.74}, inner[3] = {0.93, 0.60, 0.34};
    ex_picture *p = ex_picture_new(1500, r->scene == BLADE ? 1100 : r->scene == PLATE ? 900 : 700);
    static const double box[SCENES][2][3] = {
        {{0, 0, -0.02}, {1, 0.12, 0.25}},
        {{0, 0, 0}, {1.42, 0.2, 0.2}},
        {{0, 0, -0.25}, {1, 1, 0.1}},
        {{-0.65, -0.55, -0.5}, {0.65, 0.55, 0.5}}}; /* fragments may leave it */
    char file[32];
    int k;
    for (k = 0; k < FRAMES; ++k) {
        ex_view_begin(p, k, 2, 2, box[r->scene][0], box[r->scene][1], from[r->scene]);
        draw_part(p, &r->frame[k], 0, outer);
        draw_part(p, &r->frame[k], 1, inner);
        ex_view_end(p, r->frame[k].caption);
    }
    snprintf(file, sizeof file, "%s.png", name[r->scene]);
    ex_picture_write(p, ex_path(ex_text(&r->o, "--out"), file));
    ex_picture_free(p);
}

static void plot(run *r)
{
    static const char *const what[5] = {"kinetic + elastic", "work", "released by breaks",
                                        "damping", "error"};
    ex_plot energy = ex_plot_new("Energy", "time, s", "energy, J", 0);
    ex_plot curve = ex_plot_new("Load", "displacement, m", "force, N", 0);
    char file[32];
    int k;
    for (k = 0; k < 5; ++k)
        ex_plot_add(&energy, what[k], r->time, r->energy[k], r->steps,
                    k == 4 ? EX_LINE | EX_DASHED : EX_LINE);
    snprintf(file, sizeof file, "%s-energy.svg", name[r->scene]);
    ex_plot_write(&energy, ex_path(ex_text(&r->o, "--out"), file));
    if (r->scene == BLADE) return; /* it cuts without force */
    ex_plot_add(&curve, NULL, r->way, r->load, r->steps, EX_LINE);
    snprintf(file, sizeof file, "%s-load.svg", name[r->scene]);
    ex_plot_write(&curve, ex_path(ex_text(&r->o, "--out"), file));
}

static void play(const ex_options *o, int scene)
{
    static const double step[SCENES] = {0.003, 0.004, 0.0005, 0.004},
                        seconds[SCENES] = {1.2, 1.2, 0.16, 1.2};
    static const double shot[SCENES][FRAMES] = {
        {0.01, 0.6, 0.8, 1}, {0.01, 0.53, 0.58, 1}, {0.02, 0.08, 0.3, 1}, {0.02, 0.12, 0.4, 1}};
    sfem_fracture f;
    double start = ex_seconds();
    sfem_body_info info;
    run r;
    int k;
    memset(&r, 0, sizeof r);
    r.o = *o;
    r.scene = scene;
    r.quick = ex_given(o, "--quick") > 0;
    r.h = step[scene];
    if (ex_given(o, "--dt")) r.h = ex_positive(o, "--dt");
    r.steps = ex_steps(seconds[scene], r.h);
    memcpy(r.shot, shot[scene], sizeof r.shot);
    r.time = (double *)ex_new(8 * (size_t)r.steps, sizeof *r.time);
    r.way = r.time + r.steps;
    r.load = r.way + r.steps;
    for (k = 0; k < 5; ++k) r.energy[k] = r.load + (k + 1) * r.steps;
    make_mesh(&r);
    make_model(&r);
    make_body(&r);
    simulate(&r);
    start = ex_seconds() - start;
    draw(&r);
    plot(&r);
    f = sfem_body_fracture(r.body);
    info = sfem_body_get_info(r.body);
    printf("scene %s\nnodes %d\ntets %d\nsteps %d\nrejected %d\nsolves %ld\nfactors %d\n"
           "seconds %.2f\n",
           name[scene], (int)r.mesh.nodes, (int)r.mesh.tets, (int)r.steps, (int)info.rejected,
           (long)info.solves, (int)info.factors_made, start);
    printf("work %.4g\nreleased %.4g\nsurface %.4g\ndamped %.4g\nsafeguard %.4g\ndissipated %.4g\n", f.work,
           f.released, f.surface, f.damped, f.rejected, f.dissipated);
    if (scene == BEND) {
        double peak = 0;
        for (k = 0; k < r.steps && r.load[k] >= peak / 2; ++k) peak = fmax(peak, r.load[k]);
        printf("peak_load %.4g\ngriffith_ratio %.3f\n", peak, peak / griffith(&r));
    }
    printf("pieces %d\nbroken_edges %d\nenergy_error %.3g\n", (int)f.pieces, (int)f.broken,
           f.scale > 0 ? fabs(f.error) / f.scale : 0.0);
    for (k = 0; k < FRAMES; ++k) {
        sfem_fragments_free(&r.frame[k].surface);
        free(r.frame[k].x);
    }
    free(r.time);
    free(r.moved);
    sfem_body_free(r.body);
    sfem_model_free(r.model);
    sfem_mesh_free(&r.mesh);
}

int main(int argc, char **argv)
{
    const ex_options o =
        ex_parse(argc, argv, "Breaks bodies along the edges of their meshes.", table);
    const int chosen = ex_choice(&o, "--scene");
    int k;
    ex_make_directory(ex_text(&o, "--out"));
    for (k = 0; k < SCENES; ++k)
        if (chosen == SCENES || chosen == k) play(&o, k);
    return 0;
}
