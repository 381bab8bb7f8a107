/* gripper - two fingers squeeze a soft fruit, lift it, and feel it; with too little friction it slips out:
 *
 *      |   ,--.   |
 *    ->| ( soft ) |<-       2 mu F >= m g holds, F the force of one finger on the body
 *      |   `--'   |
 *     _____________
 *
 * The fingers are boxes that the program moves, as a robot's controller would: together until each feels the grip that
 * was asked for, then up, then still. sfem_contact_obstacle_force is what a sensor in them reads. It is done
 * twice, with --friction and with --slippery. Writes gripper.png, force.svg (what one finger feels over time),
 * curve.svg (over how far it has pressed in) and gripper.csv to the --out directory.
 *
 *     cc -O2 -c -DSOFTFEM_IMPLEMENTATION -x c softfem.h && cc -O2 -I. examples/gripper.c softfem.o -lm
 *
 * The last lines on stdout are `key value`.
 */
#include "support.h"
#include "softfem.h"
#include "elastic.h"

enum { FRAMES = 3, RUNS = 2 };

static const ex_option table[] = {
    {"--tets", "N", "4000", "of the fruit, about"},
    {"--young", "E", "5e4", "Young's modulus, Pa"},
    {"--friction", "MU", "0.8", "between fingers and fruit"},
    {"--slippery", "MU", "0.15", "the same the second time"},
    {"--grip", "G", "1.2", "force of a finger, in weights of the fruit"},
    {"--dt", "H", "0.008333333333333333", "time step, s"},
    {"--out", "DIR", "build/gripper", "where files go"},
    {"--quick", NULL, NULL, "a small run: a coarse fruit"},
    {NULL, NULL, NULL, NULL}};

/* s: fingers close until then at the latest; they go up from LIFT to HOLD */
#define CLOSE 1.0
#define LIFT  1.3
#define HOLD  2.1
#define END   2.6

typedef struct trial { /* of one friction */
    double friction, weight, grip, rise, press;
    double *normal, *tangent, *depth, *height; /* [steps]: N, N, m, m */
    double *frame[FRAMES], finger[FRAMES][2][3];
    double time[FRAMES], bite, bite_force;
} trial;

typedef struct run {
    ex_options o;
    sfem_mesh mesh;
    sfem_surface surface;
    sfem_model *model;
    double h, radius, *time;
    sfem_int steps;
    trial trial[RUNS];
} run;

static const double finger_size[3] = {0.008, 0.03, 0.035};

static void must(sfem_status status, const sfem_error *err)
{
    if (status != SFEM_OK) ex_fail("%s", err->text);
}

/* 1. A fruit of 8 cm: a ball with lobes and a dent at the top. */
static double fruit(const double x[3], void *user)
{
    const double r = sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2]), angle = atan2(x[1], x[0]);
    const double flat = r > 0 ? sqrt(x[0] * x[0] + x[1] * x[1]) / r : 0;
    const double dent = 0.012 * exp(-(x[0] * x[0] + x[1] * x[1]) / 2e-4) * (x[2] > 0);
    (void)user;
    return r - 0.04 * (1 + 0.04 * flat * cos(5 * angle)) + dent;
}

static void make_model(run *r)
{
    static const double box[2][3] = {{-0.05, -0.05, -0.05}, {0.05, 0.05, 0.05}};
    sfem_mesher_def def = sfem_default_mesher_def();
    sfem_model_def model = sfem_default_model_def();
    double lower[3], upper[3];
    sfem_error err;
    sfem_int i;
    def.tets = ex_given(&r->o, "--quick") ? 800 : (sfem_int)ex_integer(&r->o, "--tets");
    must(sfem_mesh_from_sdf(&def, fruit, NULL, box, &r->mesh, NULL, &err), &err);
    ex_bounds(r->mesh.x, r->mesh.nodes, 1, lower, upper);
    for (i = 0; i < r->mesh.nodes; ++i) r->mesh.x[3 * i + 2] -= lower[2];
    r->radius = (upper[0] - lower[0]) / 2;
    must(sfem_mesh_surface(&r->mesh, NULL, &r->surface, &err), &err);
    model.mesh = &r->mesh;
    model.material.young = ex_real(&r->o, "--young");
    model.material.poisson = 0.42;
    model.material.density = 1000;
    must(sfem_model_create(&model, &r->model, &err), &err);
    printf("fruit: %d nodes, %d tets\n", (int)r->mesh.nodes, (int)r->mesh.tets);
}

static double height_of(const run *r, const sfem_body *body) /* of its centre of mass, above where it lay */
{
    const double *u = sfem_body_displacement(body), *mass = sfem_model_node_mass(r->model);
    double sum = 0, all = 0;
    sfem_int i;
    for (i = 0; i < r->mesh.nodes; ++i) {
        sum += mass[i] * u[3 * i + 2];
        all += mass[i];
    }
    return sum / all;
}

/* 2. A table, and a finger on each side. */
static void make_scene(const run *r, const trial *t, sfem_body **body, sfem_contact **contact, sfem_int finger[2])
{
    static const double up[3] = {0, 0, 1}, origin[3] = {0, 0, 0};
    sfem_body_def def = sfem_default_body_def();
    sfem_contact_surface surface = sfem_default_contact_surface();
    sfem_obstacle_def ground = sfem_obstacle_plane(up, origin), box = sfem_default_obstacle_def();
    sfem_error err;
    int k;
    def.gravity[2] = -9.81;
    def.stiffness_damping = 0.004;
    must(sfem_body_create(r->model, &def, body, &err), &err);
    surface.friction = t->friction;
    must(sfem_contact_create(NULL, contact, &err), &err);
    must(sfem_contact_add_body(*contact, *body, &surface, ~0u, NULL, &err), &err);
    must(sfem_contact_add_obstacle(*contact, &ground, NULL, &err), &err);
    box.kind = SFEM_OBSTACLE_BOX;
    box.contact = surface;
    memcpy(box.size, finger_size, sizeof finger_size);
    for (k = 0; k < 2; ++k) {
        box.position[0] = (k ? -1 : 1) * (r->radius + finger_size[0] + 0.004);
        box.position[2] = 0.04;
        must(sfem_contact_add_obstacle(*contact, &box, &finger[k], &err), &err);
    }
}

/* The velocity of the fingers: together until the grip is felt, a pause, up, still. */
static void control(const run *r, trial *t, double now, double felt, double *inward, double *upward)
{
    const double speed = 0.03, s = (now - LIFT) / (HOLD - LIFT);
    (void)r;
    if (t->bite == 0 && felt >= t->grip) t->bite = now, t->bite_force = felt;
    *inward = t->bite == 0 && now < CLOSE ? speed : 0;
    *upward = s > 0 && s < 1 ? t->rise * 6 * s * (1 - s) / (HOLD - LIFT) : 0;
}

static void keep(const run *r, trial *t, int k, const sfem_body *body, const sfem_contact *contact, const sfem_int finger[2])
{
    double axes[9];
    int i;
    t->frame[k] = (double *)ex_new(3 * (size_t)r->mesh.nodes, sizeof(double));
    sfem_body_positions(body, t->frame[k]);
    t->time[k] = sfem_body_time(body);
    for (i = 0; i < 2; ++i) sfem_contact_obstacle_pose(contact, finger[i], t->finger[k][i], axes);
}

/* 3. One trial. */
static void play(run *r, trial *t)
{
    const sfem_int frame[FRAMES] = {(sfem_int)(CLOSE / r->h), (sfem_int)((LIFT + HOLD) / 2 / r->h), r->steps - 1};
    sfem_body *body;
    sfem_contact *contact;
    sfem_int finger[2], i;
    sfem_error err;
    double felt = 0, mass = 0;
    int k, kept = 0;
    for (i = 0; i < r->mesh.nodes; ++i) mass += sfem_model_node_mass(r->model)[i];
    t->weight = 9.81 * mass;
    t->grip = ex_real(&r->o, "--grip") * t->weight;
    t->rise = 0.08;
    make_scene(r, t, &body, &contact, finger);
    for (i = 0; i < r->steps; ++i) {
        double inward, upward, force[2][3], torque[3], at[3], axes[9];
        control(r, t, i * r->h, felt, &inward, &upward);
        for (k = 0; k < 2; ++k) {
            const double v[3] = {k ? inward : -inward, 0, upward};
            sfem_contact_obstacle_pose(contact, finger[k], at, axes);
            must(sfem_contact_move_obstacle(contact, finger[k], at, NULL, v, NULL, &err), &err);
        }
        must(sfem_contact_step(contact, r->h, &err), &err);
        for (k = 0; k < 2; ++k) sfem_contact_obstacle_force(contact, finger[k], force[k], torque);
        sfem_contact_obstacle_pose(contact, finger[0], at, axes);
        felt = (force[0][0] - force[1][0]) / 2;
        t->normal[i] = felt;
        t->tangent[i] = -(force[0][2] + force[1][2]) / 2;
        t->depth[i] = fmax(0, r->radius + finger_size[0] - at[0]);
        t->height[i] = height_of(r, body);
        if (kept < FRAMES && i >= frame[kept]) keep(r, t, kept++, body, contact, finger);
        ex_progress(t == r->trial ? "gripper" : "slippery", i, r->steps);
    }
    sfem_contact_free(contact);
    sfem_body_free(body);
}

/* 4. Pictures, plots, a table. */
static void draw_finger(ex_picture *p, const double at[3])
{
    static const int32_t tri[12][3] = {{0, 2, 3}, {0, 3, 1}, {4, 5, 7}, {4, 7, 6}, {0, 1, 5}, {0, 5, 4},
                                       {2, 6, 7}, {2, 7, 3}, {0, 4, 6}, {0, 6, 2}, {1, 3, 7}, {1, 7, 5}};
    ex_style grey = ex_default_style();
    double x[8][3];
    int k, c;
    for (k = 0; k < 8; ++k)
        for (c = 0; c < 3; ++c) x[k][c] = at[c] + (k >> c & 1 ? 1 : -1) * finger_size[c];
    grey.color[0] = grey.color[1] = 0.5;
    grey.color[2] = 0.55;
    grey.edges = 0;
    grey.flat = 1;
    ex_view_surface(p, 8, x[0], 12, tri[0], NULL, &grey);
}

static void draw(const run *r)
{
    static const char *const what[FRAMES] = {"squeezed", "lifted", "held"};
    const double direction[3] = {0.4, -1, 0.25};
    const int quick = ex_given(&r->o, "--quick");
    ex_picture *p = ex_picture_new(quick ? 1050 : 1500, quick ? 600 : 860);
    ex_style style = ex_default_style();
    double lower[3], upper[3], low, high;
    int j, k;
    p->ground = 0;
    p->bar = 1;
    for (j = 0; j < RUNS; ++j)
        for (k = 0; k < FRAMES; ++k) {
            double *value = ex_node_stress(r->model, &r->mesh, r->trial[j].frame[k]);
            ex_range(value, r->mesh.nodes, &low, &high);
            style.high = fmax(style.high * (j + k > 0), high);
            ex_bounds(r->trial[j].frame[k], r->mesh.nodes, j + k == 0, lower, upper);
            ex_bounds(r->trial[j].finger[k][0], 2, 0, lower, upper);
            free(value);
        }
    style.low = lower[2] = 0;
    for (j = 0; j < RUNS; ++j)
        for (k = 0; k < FRAMES; ++k) {
            const trial *t = r->trial + j;
            double *value = ex_node_stress(r->model, &r->mesh, t->frame[k]);
            char caption[80];
            const int slipped = k > 0 && t->height[(sfem_int)(t->time[k] / r->h) - 1] < 0.5 * t->rise * (k == 1 ? 0.5 : 1);
            ex_view_begin(p, FRAMES * j + k, FRAMES, RUNS, lower, upper, direction);
            draw_finger(p, t->finger[k][0]);
            draw_finger(p, t->finger[k][1]);
            ex_view_surface(p, r->mesh.nodes, t->frame[k], r->surface.triangles, r->surface.tri, value, &style);
            snprintf(caption, sizeof caption, "friction %.2g, %.2f s: %s", t->friction, t->time[k],
                     slipped ? "slipped" : what[k]);
            ex_view_end(p, caption);
            free(value);
        }
    ex_colorbar(p, "stress, Pa", 0, style.high);
    ex_picture_write(p, ex_path(ex_text(&r->o, "--out"), "gripper.png"));
    ex_picture_free(p);
}

static void plot(const run *r)
{
    const char *out = ex_text(&r->o, "--out");
    ex_plot force = ex_plot_new("What one finger feels", "time, s", "force, N", 0);
    ex_plot curve = ex_plot_new("Force over depth, as it closes", "how far a finger has pressed in, m", "force, N", 0);
    FILE *f = ex_open(ex_path(out, "gripper.csv"));
    char name[2 * RUNS][48];
    sfem_int i, closing = (sfem_int)(r->trial[0].bite / r->h);
    int j;
    for (j = 0; j < RUNS; ++j) {
        snprintf(name[2 * j], sizeof *name, "squeeze, friction %.2g", r->trial[j].friction);
        snprintf(name[2 * j + 1], sizeof *name, "lift, friction %.2g", r->trial[j].friction);
        ex_plot_add(&force, name[2 * j], r->time, r->trial[j].normal, r->steps, EX_LINE);
        ex_plot_add(&force, name[2 * j + 1], r->time, r->trial[j].tangent, r->steps, EX_LINE);
    }
    ex_plot_write(&force, ex_path(out, "force.svg"));
    ex_plot_add(&curve, NULL, r->trial[0].depth, r->trial[0].normal, closing > 1 ? closing : r->steps, EX_LINE);
    ex_plot_write(&curve, ex_path(out, "curve.svg"));
    fprintf(f, "time,normal,lift,depth,height,slippery_normal,slippery_lift,slippery_depth,slippery_height\n");
    for (i = 0; i < r->steps; ++i) {
        fprintf(f, "%.6g", r->time[i]);
        for (j = 0; j < RUNS; ++j)
            fprintf(f, ",%.9g,%.9g,%.9g,%.9g", r->trial[j].normal[i], r->trial[j].tangent[i], r->trial[j].depth[i],
                    r->trial[j].height[i]);
        fprintf(f, "\n");
    }
    ex_close(f, ex_path(out, "gripper.csv"));
}

int main(int argc, char **argv)
{
    run r;
    sfem_int i;
    int j, k;
    memset(&r, 0, sizeof r);
    r.o = ex_parse(argc, argv, "Two fingers squeeze, lift and feel a soft fruit.", table);
    r.h = ex_positive(&r.o, "--dt");
    r.steps = ex_steps(END, r.h);
    ex_make_directory(ex_text(&r.o, "--out"));
    make_model(&r);
    r.time = (double *)ex_new((1 + 4 * RUNS) * (size_t)r.steps, sizeof *r.time);
    for (i = 0; i < r.steps; ++i) r.time[i] = (i + 1) * r.h;
    for (j = 0; j < RUNS; ++j) {
        trial *t = r.trial + j;
        t->friction = ex_real(&r.o, j ? "--slippery" : "--friction");
        t->normal = r.time + (1 + 4 * j) * r.steps;
        t->tangent = t->normal + r.steps;
        t->depth = t->tangent + r.steps;
        t->height = t->depth + r.steps;
        play(&r, t);
    }
    draw(&r);
    plot(&r);
    printf("wrote %s/gripper.png, force.svg, curve.svg, gripper.csv\n", ex_text(&r.o, "--out"));
    printf("weight %.4g\ngrip %.4g\n", r.trial[0].weight, r.trial[0].normal[r.steps - 1]);
    printf("lift_per_finger %.6g\nheld_at %.4g\nslipped_at %.4g\n", r.trial[0].tangent[r.steps - 1],
           r.trial[0].height[r.steps - 1], r.trial[1].height[r.steps - 1]);
    for (j = 0; j < RUNS; ++j)
        for (k = 0; k < FRAMES; ++k) free(r.trial[j].frame[k]);
    free(r.time);
    sfem_model_free(r.model);
    sfem_surface_free(&r.surface);
    sfem_mesh_free(&r.mesh);
    return 0;
}
