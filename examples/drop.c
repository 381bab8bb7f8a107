/* drop - a soft creature falls on a stone, bounces, is dragged over the ground, comes to rest and sleeps:
 *
 *          ,-.__,-.
 *         (  body  )         0 <= l_n, gap(x') >= 0, l_n gap = 0      |l_t| <= mu l_n
 *          `-.,-.,'          w' = w_free + A^-1 J^T l
 *     ____(stone)______
 *
 * The body is made of rounded limbs here (sfem_mesh_from_sdf), or read from a file; it falls on the ground and a
 * sphere. After a while a hand takes its highest node and draws it sideways, then lets go. Writes drop.png,
 * energy.svg, force.svg and drop.csv to the --out directory.
 *
 *     cc -O2 -c -DSOFTFEM_IMPLEMENTATION -x c softfem.h && cc -O2 -I. examples/drop.c softfem.o -lm
 *
 * The last lines on stdout are `key value`.
 */
#include "support.h"
#include "softfem.h"

enum { FRAMES = 6 };

static const ex_option table[] = {
    {"MESH", "FILE", NULL, "a mesh of tets; without it a creature with limbs, 1.4 m long"},
    {"--tets", "N", "3000", "of the creature, about"},
    {"--young", "E", "1e5", "Young's modulus, Pa"},
    {"--friction", "MU", "0.5", "of body and ground"},
    {"--restitution", "E", "0", "of each node; 0: what comes back is what the body stores"},
    {"--height", "H", "0.6", "of its lowest point, m"},
    {"--dt", "H", "0.016666666666666667", "time step, s"},
    {"--seconds", "T", "10", "it is dragged from 3/8 to 1/2 of that"},
    {"--out", "DIR", "build/drop", "where files go"},
    {"--quick", NULL, NULL, "a small run: a coarse body"},
    {NULL, NULL, NULL, NULL}};

typedef struct run {
    ex_options o;
    sfem_mesh mesh, stone;
    sfem_surface surface, stone_surface;
    sfem_model *model;
    sfem_body *body;
    sfem_contact *contact;
    double h, largest, step_seconds, worst_seconds, penetration;
    sfem_int steps, asleep; /* asleep: since this step, or -1 */
    double *time, *energy[3], *contacts, *force; /* [steps] */
    double *frame[FRAMES];
    char caption[FRAMES][48];
} run;

static void must(sfem_status status, const sfem_error *err)
{
    if (status != SFEM_OK) ex_fail("%s", err->text);
}

/* 1. The creature: limbs as rods with round ends, blended by a smooth minimum. */
static double creature(const double x[3], void *user)
{
    static const double rod[7][7] = {{-0.35, 0, 0, 0.25, 0, 0.02, 0.2},      {0.25, 0, 0.02, 0.52, 0, 0.14, 0.14},
                                     {0.2, 0.14, -0.05, 0.3, 0.3, -0.38, 0.1}, {0.2, -0.14, -0.05, 0.3, -0.3, -0.38, 0.1},
                                     {-0.35, 0.13, -0.05, -0.45, 0.28, -0.38, 0.1},
                                     {-0.35, -0.13, -0.05, -0.45, -0.28, -0.38, 0.1},
                                     {-0.45, 0, 0.06, -0.85, 0, 0.3, 0.09}};
    double sum = 0;
    int i, c;
    (void)user;
    for (i = 0; i < 7; ++i) {
        double along = 0, length = 0, d2 = 0;
        for (c = 0; c < 3; ++c) {
            const double d = rod[i][3 + c] - rod[i][c];
            along += d * (x[c] - rod[i][c]);
            length += d * d;
        }
        along = ex_clamp(along / length, 0, 1);
        for (c = 0; c < 3; ++c) {
            const double d = x[c] - rod[i][c] - along * (rod[i][3 + c] - rod[i][c]);
            d2 += d * d;
        }
        sum += exp(-(sqrt(d2) - rod[i][6]) / 0.03);
    }
    return -0.03 * log(sum);
}

static void make_mesh(run *r)
{
    static const double box[2][3] = {{-1.1, -0.5, -0.6}, {0.8, 0.5, 0.5}};
    const char *path = ex_text(&r->o, "MESH");
    double lower[3], upper[3];
    sfem_error err;
    sfem_int i;
    int c;
    if (path) {
#ifdef SFEM_NO_MESHIO
        ex_fail("this build reads no files");
#else
        must(sfem_mesh_read(path, NULL, &r->mesh, &err), &err);
#endif
    } else {
        sfem_mesher_def def = sfem_default_mesher_def();
        def.tets = ex_given(&r->o, "--quick") ? 1600 : (sfem_int)ex_integer(&r->o, "--tets");
        must(sfem_mesh_from_sdf(&def, creature, NULL, box, &r->mesh, NULL, &err), &err);
    }
    ex_bounds(r->mesh.x, r->mesh.nodes, 1, lower, upper);
    for (i = 0; i < 3 * r->mesh.nodes; ++i)
        r->mesh.x[i] -= i % 3 == 2 ? lower[2] - ex_real(&r->o, "--height") : (lower[i % 3] + upper[i % 3]) / 2;
    for (c = 0; c < 3; ++c) r->largest = fmax(r->largest, upper[c] - lower[c]);
    must(sfem_mesh_surface(&r->mesh, NULL, &r->surface, &err), &err);
    printf("body: %d nodes, %d tets\n", (int)r->mesh.nodes, (int)r->mesh.tets);
}

/* 2. Model, body, and what it falls on: the ground, and a stone of a ninth of its length. */
static void make_scene(run *r)
{
    static const double up[3] = {0, 0, 1}, origin[3] = {0, 0, 0};
    sfem_model_def model = sfem_default_model_def();
    sfem_body_def def = sfem_default_body_def();
    sfem_contact_surface surface = sfem_default_contact_surface();
    sfem_obstacle_def ground = sfem_obstacle_plane(up, origin), stone = sfem_default_obstacle_def();
    sfem_error err;
    sfem_int i;
    model.mesh = &r->mesh;
    model.material.young = ex_real(&r->o, "--young");
    model.material.poisson = 0.4;
    model.material.density = 1000;
    must(sfem_model_create(&model, &r->model, &err), &err);
    def.gravity[2] = -9.81;
    def.stiffness_damping = 0.01;
    def.mass_damping = 2;
    def.sleep_tolerance = 0.05;
    must(sfem_body_create(r->model, &def, &r->body, &err), &err);
    surface.friction = ex_real(&r->o, "--friction");
    surface.restitution = ex_real(&r->o, "--restitution");
    must(sfem_contact_create(NULL, &r->contact, &err), &err);
    must(sfem_contact_add_body(r->contact, r->body, &surface, ~0u, NULL, &err), &err);
    ground.contact = stone.contact = surface;
    must(sfem_contact_add_obstacle(r->contact, &ground, NULL, &err), &err);
    stone.kind = SFEM_OBSTACLE_SPHERE;
    stone.size[0] = r->largest / 9;
    stone.position[0] = 0.25 * r->largest;
    must(sfem_contact_add_obstacle(r->contact, &stone, NULL, &err), &err);
    must(sfem_mesh_ball(stone.size[0], 8, NULL, &r->stone, &err), &err);
    for (i = 0; i < r->stone.nodes; ++i) r->stone.x[3 * i] += stone.position[0];
    must(sfem_mesh_surface(&r->stone, NULL, &r->stone_surface, &err), &err);
}

static void keep(run *r, int k, const char *what, double t)
{
    r->frame[k] = (double *)ex_new(3 * (size_t)r->mesh.nodes, sizeof(double));
    sfem_body_positions(r->body, r->frame[k]);
    snprintf(r->caption[k], sizeof r->caption[k], "%.2f s: %s", t, what);
}

/* The deepest node under the ground. */
static double depth(const run *r)
{
    const sfem_real *u = sfem_body_displacement(r->body);
    double most = 0;
    sfem_int i;
    for (i = 0; i < 3 * r->surface.triangles; ++i) {
        const size_t at = 3 * (size_t)r->surface.tri[i] + 2;
        most = fmax(most, -r->mesh.x[at] - u[at]);
    }
    return most;
}

/* The highest node now. */
static sfem_int highest(const run *r)
{
    const sfem_real *u = sfem_body_displacement(r->body);
    sfem_int i, best = 0;
    for (i = 0; i < r->mesh.nodes; ++i)
        if (r->mesh.x[3 * i + 2] + u[3 * i + 2] > r->mesh.x[3 * best + 2] + u[3 * best + 2]) best = i;
    return best;
}

/* 3. It falls; a hand draws it sideways by its highest node, lets go, and it comes to rest. */
static void play(run *r)
{
    const sfem_int take = r->steps * 3 / 8, leave = r->steps / 2;
    const sfem_int frame[FRAMES] = {0, (sfem_int)(0.48 / r->h), (sfem_int)(0.85 / r->h), take + (leave - take) / 2, leave + 1,
                                    r->steps - 1};
    static const char *const what[FRAMES] = {"falls", "lands", "bounces", "is dragged", "is let go", "rests"};
    sfem_int i, handle = -1;
    double at[3], force[3], torque[3], start, spent;
    sfem_error err;
    int k = 0;
    r->asleep = -1;
    for (i = 0; i < r->steps; ++i) {
        sfem_energy e;
        if (i == take) {
            must(sfem_body_grab_node(r->body, highest(r), &handle, &err), &err);
            sfem_body_handle_position(r->body, handle, at);
        }
        if (i >= take && i < leave) {
            at[0] -= 0.7 * r->largest / (leave - take);
            at[1] -= 0.3 * r->largest / (leave - take);
            must(sfem_body_move_handle(r->body, handle, at, &err), &err);
        }
        if (i == leave) sfem_body_release_handle(r->body, handle);
        start = ex_seconds();
        must(sfem_contact_step(r->contact, r->h, &err), &err);
        spent = ex_seconds() - start;
        r->step_seconds += spent / r->steps;
        r->worst_seconds = fmax(r->worst_seconds, spent);
        r->penetration = fmax(r->penetration, depth(r));
        e = sfem_body_energy(r->body);
        sfem_contact_obstacle_force(r->contact, 0, force, torque);
        r->time[i] = (i + 1) * r->h;
        r->energy[0][i] = e.kinetic;
        r->energy[1][i] = e.elastic;
        r->energy[2][i] = e.total;
        r->contacts[i] = sfem_contact_get_info(r->contact).contacts;
        r->force[i] = -force[2];
        if (!sfem_body_is_asleep(r->body)) r->asleep = -1;
        else if (r->asleep < 0) r->asleep = i;
        while (k < FRAMES && i >= frame[k]) {
            keep(r, k, k == FRAMES - 1 && r->asleep >= 0 ? "sleeps" : what[k], r->time[i]);
            ++k;
        }
        ex_progress("drop", i, r->steps);
    }
}

/* 4. Pictures, plots, a table. */
static void draw(const run *r)
{
    const double direction[3] = {0.25, -1, 0.35};
    const int quick = ex_given(&r->o, "--quick");
    ex_picture *p = ex_picture_new(quick ? 1050 : 1500, quick ? 600 : 860);
    ex_style style = ex_default_style(), grey = ex_default_style();
    double lower[3], upper[3];
    int k;
    p->ground = 0;
    grey.color[0] = grey.color[1] = grey.color[2] = 0.55;
    grey.edges = 0;
    style.color[0] = 0.86;
    style.color[1] = 0.52;
    style.color[2] = 0.36;
    ex_bounds(r->stone.x, r->stone.nodes, 1, lower, upper);
    for (k = 0; k < FRAMES; ++k) ex_bounds(r->frame[k], r->mesh.nodes, 0, lower, upper);
    lower[2] = 0;
    for (k = 0; k < FRAMES; ++k) {
        ex_view_begin(p, k, 3, 2, lower, upper, direction);
        ex_view_surface(p, r->stone.nodes, r->stone.x, r->stone_surface.triangles, r->stone_surface.tri, NULL, &grey);
        ex_view_surface(p, r->mesh.nodes, r->frame[k], r->surface.triangles, r->surface.tri, NULL, &style);
        ex_view_end(p, r->caption[k]);
    }
    ex_picture_write(p, ex_path(ex_text(&r->o, "--out"), "drop.png"));
    ex_picture_free(p);
}

static void plot(const run *r)
{
    static const char *const name[3] = {"kinetic", "elastic", "total, with gravity's"};
    const char *out = ex_text(&r->o, "--out");
    ex_plot energy = ex_plot_new("Energy of the body", "time, s", "energy, J", 0);
    ex_plot force = ex_plot_new("Force on the ground", "time, s", "force, N", 0);
    FILE *f = ex_open(ex_path(out, "drop.csv"));
    sfem_int i;
    int k;
    for (k = 0; k < 3; ++k) ex_plot_add(&energy, name[k], r->time, r->energy[k], r->steps, EX_LINE);
    ex_plot_write(&energy, ex_path(out, "energy.svg"));
    ex_plot_add(&force, NULL, r->time, r->force, r->steps, EX_LINE);
    ex_plot_write(&force, ex_path(out, "force.svg"));
    fprintf(f, "time,kinetic,elastic,total,contacts,force\n");
    for (i = 0; i < r->steps; ++i)
        fprintf(f, "%.6g,%.9g,%.9g,%.9g,%g,%.9g\n", r->time[i], r->energy[0][i], r->energy[1][i], r->energy[2][i],
                r->contacts[i], r->force[i]);
    ex_close(f, ex_path(out, "drop.csv"));
}

int main(int argc, char **argv)
{
    sfem_contact_info info;
    sfem_int i;
    double most = 0;
    run r;
    int k;
    memset(&r, 0, sizeof r);
    r.o = ex_parse(argc, argv, "A soft body falls, bounces, is dragged, rests and sleeps.", table);
    r.h = ex_positive(&r.o, "--dt");
    r.steps = ex_steps(ex_positive(&r.o, "--seconds"), r.h);
    if (r.steps * r.h < 2) ex_fail("--seconds must be at least 2");
    ex_make_directory(ex_text(&r.o, "--out"));
    make_mesh(&r);
    make_scene(&r);
    r.time = (double *)ex_new(6 * (size_t)r.steps, sizeof *r.time);
    for (k = 0; k < 3; ++k) r.energy[k] = r.time + (k + 1) * r.steps;
    r.contacts = r.time + 4 * r.steps;
    r.force = r.time + 5 * r.steps;
    play(&r);
    draw(&r);
    plot(&r);
    info = sfem_contact_get_info(r.contact);
    for (i = 0; i < r.steps; ++i) most = fmax(most, r.contacts[i]);
    printf("wrote %s/drop.png, energy.svg, force.svg, drop.csv\n", ex_text(&r.o, "--out"));
    printf("step_us %.1f\nworst_step_us %.1f\ncolumns %d\nmost_contacts %g\npenetration %.3g\n", 1e6 * r.step_seconds,
           1e6 * r.worst_seconds, (int)info.columns, most, r.penetration);
    printf("contact_work %.6g\nrejected %ld\nasleep_at %.3g\n", info.work, (long)sfem_body_get_info(r.body).rejected,
           r.asleep < 0 ? -1.0 : r.time[r.asleep]);
    for (k = 0; k < FRAMES; ++k) free(r.frame[k]);
    free(r.time);
    sfem_contact_free(r.contact);
    sfem_body_free(r.body);
    sfem_model_free(r.model);
    sfem_surface_free(&r.surface);
    sfem_surface_free(&r.stone_surface);
    sfem_mesh_free(&r.mesh);
    sfem_mesh_free(&r.stone);
    return 0;
}
