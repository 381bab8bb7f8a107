/* Hashes of what bodies do: the scenes of stress.h, shortened, by every form of every integrator, the options of a body
 * that those leave out, and the scenes of examples/scenes. For edits that must not change a bit: keep the output, edit, compare.
 *
 *     build/bench/hash [--every N]     each line: 64 bits of a hash, steps done, the scene
 *
 * A hash covers displacements, velocities, reactions, energies, counts, what stress.h measures, and the messages of
 * steps that fail. It depends on the compiler, its flags and the processor. Of stress.h's scenes and forms one in N is
 * run, 4 by default, for 40 steps.
 */
#define _DEFAULT_SOURCE
#include "stress.h"
#include "../tests/linear.h"
#include "../tests/blocks.h"
#include "../examples/scenes/all.h"

static uint64_t hash_of(uint64_t hash, const void *data, size_t bytes)
{
    const unsigned char *p = (const unsigned char *)data;
    size_t i;
    for (i = 0; i < bytes; ++i) hash = (hash ^ p[i]) * 0x100000001b3u;
    return hash;
}

static uint64_t hash_int(uint64_t hash, int64_t x) { return hash_of(hash, &x, sizeof x); }
static uint64_t hash_real(uint64_t hash, double x) { return hash_of(hash, &x, sizeof x); }

static uint64_t hash_body(uint64_t hash, sfem_body *b)
{
    const sfem_body_info info = sfem_body_get_info(b);
    const sfem_newton_info newton = sfem_body_newton(b);
    const sfem_energy e = sfem_body_energy(b);
    const size_t n = 3 * (size_t)info.nodes;
    double *x = (double *)body_new(n, sizeof *x);
    hash = hash_of(hash, sfem_body_displacement(b), n * sizeof *x);
    sfem_body_velocities(b, x);
    hash = hash_of(hash, x, n * sizeof *x);
    sfem_body_reactions(b, x);
    hash = hash_of(hash, x, n * sizeof *x);
    free(x);
    hash = hash_real(hash, sfem_body_time(b));
    hash = hash_real(hash, e.kinetic);
    hash = hash_real(hash, e.elastic);
    hash = hash_real(hash, e.conserved);
    hash = hash_int(hash, info.steps);
    hash = hash_int(hash, info.rejected);
    hash = hash_int(hash, info.solves);
    hash = hash_int(hash, info.evaluations);
    hash = hash_int(hash, newton.iterations);
    hash = hash_real(hash, newton.residual);
    return hash_int(hash, sfem_body_fracture(b).broken);
}

static uint64_t hash_result(uint64_t hash, const stress_result *r)
{
    hash = hash_real(hash, r->excess);
    hash = hash_real(hash, r->drift);
    hash = hash_real(hash, r->linear);
    hash = hash_real(hash, r->angular);
    hash = hash_real(hash, r->shape);
    hash = hash_real(hash, r->lost);
    hash = hash_int(hash, r->steps);
    return hash_of(hash, r->why, strlen(r->why));
}

static void print(uint64_t hash, int steps, const char *scene, const char *form)
{
    printf("%016llx %5d %s, %s\n", (unsigned long long)hash, steps, scene, form);
    fflush(stdout);
}

/* ---- the scenes of stress.h ---- */

static void hash_scene(stress_scene scene, stress_form form)
{
    uint64_t random = scene.seed * 0x9e3779b97f4a7c15u + 12345, hash = 0xcbf29ce484222325u;
    stress_result r;
    stress_body s;
    sfem_body_def def;
    sfem_error err;
    scene.steps = scene.family == STRESS_STREAM ? 200 : 40;
    if (scene.family == STRESS_MODAL || scene.family == STRESS_STREAM ||
        scene.family == STRESS_EIGEN) {
        r = stress_run(&scene, form);
        print(hash_result(hash, &r), r.steps, scene.name, stress_form_name((int)form));
        return;
    }
    memset(&r, 0, sizeof r);
    memset(&err, 0, sizeof err);
    if (stress_build(&scene, form, &random, &s, &err) == SFEM_OK) {
        def = stress_def(&s, form, scene.h);
        def.gravity[1] = -s.gravity;
        if (sfem_body_create(s.model, &def, &s.body, &err) == SFEM_OK) {
            stress_state(&s, &random);
            sfem_body_set_state(s.body, s.u0, s.v0, &err);
            if (scene.family >= STRESS_FALL)
                stress_six_seconds(&s, form, &random, &r);
            else
                stress_violence(&s, form, scene.h, &random, &r);
            hash = hash_body(hash, s.body);
        }
    }
    hash = hash_of(hash_result(hash, &r), err.text, strlen(err.text));
    print(hash, r.steps, scene.name, stress_form_name((int)form));
    stress_free(&s);
}

/* ---- options that no scene of stress.h has ---- */

#define HASH_OPTIONS(X)                                                                            \
    X(PIECE, "frame of the piece")                                                                 \
    X(REFACTORISE, "refactorised")                                                                 \
    X(DAMPED, "Rayleigh damping")                                                                  \
    X(DRAG, "a damping force")                                                                     \
    X(PLAIN, "plain load, q = 1.2")                                                                \
    X(FLOATS, "mixed precision")                                                                   \
    X(LUMPED_NOT, "consistent mass")                                                               \
    X(SLEEP, "falls asleep")                                                                       \
    X(STATIC, "static equilibrium first")                                                          \
    X(PINS, "pins change")                                                                         \
    X(REPIN_AXES, "pins of single axes move")                                                      \
    X(HANDLES, "three handles")                                                                    \
    X(REGIONS, "regions that yield")                                                               \
    X(SAVED, "saved, stepped, loaded, stepped")                                                    \
    X(FOURTH, "start of fourth order")                                                             \
    X(GUI, "Gui-lambda")                                                                           \
    X(CHANG, "Chang")                                                                              \
    X(ZSZ, "damage by the law ZSZ")                                                                \
    X(TOLD, "edges told to break, healed")

typedef enum hash_option {
#define HASH_ENUM(name, text) HASH_##name,
    HASH_OPTIONS(HASH_ENUM)
#undef HASH_ENUM
        HASH_OPTION_COUNT
} hash_option;

static const char *hash_option_name(hash_option k)
{
#define HASH_TEXT(name, text) text,
    static const char *const texts[] = {HASH_OPTIONS(HASH_TEXT)};
#undef HASH_TEXT
    return texts[k];
}

static void hash_drag(void *user, const double *v, double *force)
{
    const sfem_int nodes = *(const sfem_int *)user;
    sfem_int i;
    for (i = 0; i < 3 * nodes; ++i) force[i] += 0.5 * v[i] * (1 + fabs(v[i]));
}

typedef struct hash_rig {
    sfem_mesh mesh;
    sfem_model *model;
    sfem_body *body;
    sfem_int pin[64], pins, handle[3];
    sfem_damage_def damage;
} hash_rig;

/* A bar of 0.8 x 0.3 x 0.3 m and cells of 0.1 m, its nodes moved a little, held at x = 0. */
static sfem_status hash_build(hash_rig *g, sfem_law law, hash_option option, sfem_error *err)
{
    static const sfem_int cells[3] = {8, 3, 3};
    static const double size[3] = {0.8, 0.3, 0.3};
    sfem_model_def def = linear_model_def();
    sfem_body_def body = sfem_default_body_def();
    uint64_t random = 3;
    sfem_status status = block_mesh(cells, size, 0.02, &random, &g->mesh, err);
    if (status) return status;
    g->pins = block_clamp(cells, g->pin);
    def.mesh = &g->mesh;
    def.material = linear_material();
    def.material.young = 2e5;
    def.material.law = law;
    if (option == HASH_LUMPED_NOT) def.mass = SFEM_MASS_CONSISTENT;
    status = sfem_model_create(&def, &g->model, err);
    if (status) return status;
    body.pins = g->pin;
    body.pin_count = g->pins;
    body.gravity[2] = -9.81;
    if (option != HASH_REGIONS) body.handle_compliance = 0;
    else body.handle_max_force = 30;
    g->damage = sfem_default_damage_def();
    switch (option) {
    case HASH_PIECE:
        body.frame = SFEM_FRAME_PIECE;
        break;
    case HASH_REFACTORISE:
        body.refactorise = 4;
        break;
    case HASH_DAMPED:
        body.mass_damping = 0.3, body.stiffness_damping = 1e-3;
        break;
    case HASH_DRAG:
        body.damping_force.force = hash_drag, body.damping_force.user = &g->mesh.nodes;
        break;
    case HASH_PLAIN:
        body.plain_load = 1, body.q = 1.2, body.mass_damping = 1;
        break;
    case HASH_FLOATS:
        body.precision = SFEM_MIXED;
        break;
    case HASH_SLEEP:
        body.sleep_tolerance = 1, body.sleep_time = 0.1, body.mass_damping = 20;
        break;
    case HASH_FOURTH:
        body.start = SFEM_START_FOURTH_ORDER, body.p = 1.0 / 12;
        break;
    case HASH_GUI:
        body.integrator = SFEM_GUI;
        break;
    case HASH_CHANG:
        body.integrator = SFEM_CHANG;
        break;
    case HASH_ZSZ:
        g->damage.law = SFEM_DAMAGE_ZSZ;
        g->damage.toughness = 2;
        body.damage = &g->damage;
        break;
    case HASH_TOLD:
        body.damage = &g->damage;
        break;
    default:
        break;
    }
    return sfem_body_create(g->model, &body, &g->body, err);
}

/* What happens before step k. */
static sfem_status hash_act(hash_rig *g, sfem_law law, hash_option option, int k, sfem_error *err)
{
    static const double push[3] = {3, 1, -2}, to[9] = {0.5, -1, 1, 0.5, 2, 1, 0.5, 0.5, -2};
    static const double from[9] = {0.4, -1, 1, 0.4, 2, 1, 0.4, 0.5, -2};
    const sfem_int last = g->mesh.nodes - 1;
    double x[3];
    int c, i;
    if (option == HASH_REFACTORISE && k == 4 && law != SFEM_LINEAR)
        return sfem_body_refactorise(g->body, NULL, err);
    if (option == HASH_SLEEP && k == 30) return sfem_body_add_lasting_force(g->body, last, push, err);
    if (option == HASH_STATIC && k == 0) return sfem_body_solve_static(g->body, err);
    if (option == HASH_PINS && k % 10 == 5)
        return sfem_body_set_pins(g->body, g->pins - k / 10, g->pin, NULL, err);
    if (option == HASH_REPIN_AXES) {
        static const unsigned char axes[3] = {1, 6, 7};
        if (k == 5) return sfem_body_set_pins(g->body, 3, g->pin, axes, err);
        for (c = 0; c < 3; ++c) x[c] = g->mesh.x[3 * g->pin[2] + c] + 0.002 * k;
        if (k > 5) return sfem_body_move_pin(g->body, g->pin[2], x, err);
    }
    if (option == HASH_HANDLES) {
        static const double bary[4] = {0.1, 0.2, 0.3, 0.4};
        sfem_status status = SFEM_OK;
        if (k == 3) status = sfem_body_grab_node(g->body, last, g->handle, err);
        if (k == 3 && !status) status = sfem_body_grab_node(g->body, last - 7, g->handle + 1, err);
        if (k == 6 && !status) status = sfem_body_grab_point(g->body, 40, bary, g->handle + 2, err);
        for (i = 0; i < (k < 3 ? 0 : k < 6 ? 2 : 3) && !status && k < 30; ++i) {
            sfem_body_handle_position(g->body, g->handle[i], x);
            for (c = 0; c < 3; ++c) x[c] += 0.003 * ((k + i + c) % 4);
            status = sfem_body_move_handle(g->body, g->handle[i], x, err);
        }
        if (k == 30) sfem_body_release_handle(g->body, g->handle[1]);
        return status;
    }
    if (option == HASH_REGIONS && (k == 3 || k == 6)) {
        sfem_int node[12];
        for (i = 0; i < 12; ++i) node[i] = last - i - 3 * k + 9;
        return sfem_body_grab_region(g->body, 12, node, NULL, g->handle + (k == 6), err);
    }
    if (option == HASH_REGIONS && k > 6 && k < 30) {
        sfem_body_handle_position(g->body, g->handle[k % 2], x);
        for (c = 0; c < 3; ++c) x[c] += 0.02 * ((k + c) % 4);
        return sfem_body_move_handle(g->body, g->handle[k % 2], x, err);
    }
    if (option == HASH_REGIONS && k == 30) sfem_body_release_handle(g->body, g->handle[1]);
    if (option == HASH_SAVED && k == 20) {
        const size_t bytes = sfem_body_state_size(g->body);
        void *block = body_new(bytes, 1);
        sfem_status status = SFEM_OK;
        sfem_body_save_state(g->body, block);
        for (i = 0; i < 5 && !status; ++i) status = sfem_body_step(g->body, 0.01, err);
        if (!status) status = sfem_body_load_state(g->body, block, bytes, err);
        free(block);
        return status;
    }
    if (option == HASH_TOLD && k == 5) return sfem_body_cut(g->body, from, to, NULL, err);
    if (option == HASH_TOLD && k == 30) sfem_body_heal(g->body);
    return SFEM_OK;
}

static void hash_options(sfem_law law, hash_option option)
{
    static const char *const laws[] = {"linear", "corotational", "StVK", "neo-Hookean"};
    uint64_t hash = 0xcbf29ce484222325u;
    sfem_error err;
    hash_rig g;
    sfem_status status;
    const double h = option == HASH_FOURTH ? 1e-3 : 0.01;
    int k;
    memset(&g, 0, sizeof g);
    memset(&err, 0, sizeof err);
    status = hash_build(&g, law, option, &err);
    for (k = 0; k < 40 && !status; ++k) {
        status = hash_act(&g, law, option, k, &err);
        if (!status) status = sfem_body_step(g.body, k % 20 == 19 ? 2 * h : h, &err);
        if (!status) hash = hash_body(hash, g.body);
    }
    if (g.body) hash = hash_body(hash, g.body);
    hash = hash_of(hash, err.text, strlen(err.text));
    print(hash, k, laws[law], hash_option_name(option));
    sfem_body_free(g.body);
    sfem_model_free(g.model);
    sfem_mesh_free(&g.mesh);
}

static void hash_example(const sc_scene *scene)
{
    uint64_t hash = 0xcbf29ce484222325u;
    sfem_error err;
    sc_world *w;
    int k;
    memset(&err, 0, sizeof err);
    w = sc_open(scene, NULL, &err);
    for (k = 0; w && k < 40 && !sc_step(w, &err); ++k) {
        hash = hash_int(hash, (int64_t)sc_hash(w));
        if (w->item[0].body) hash = hash_body(hash, w->item[0].body);
    }
    hash = hash_of(hash, err.text, strlen(err.text));
    print(hash, k, "examples/scenes", scene->name);
    sc_close(w);
}

int main(int argc, char **argv)
{
    int every = 4, k, f, law;
    stress_scene s;
    if (argc == 3 && !strcmp(argv[1], "--every") && atoi(argv[2]) > 0) {
        every = atoi(argv[2]);
    } else if (argc > 1) {
        fputs("usage: hash [--every N, 4]\n", stderr);
        return 2;
    }
    for (law = SFEM_LINEAR; law <= SFEM_NEOHOOKEAN; ++law)
        for (k = 0; k < HASH_OPTION_COUNT; ++k) hash_options((sfem_law)law, (hash_option)k);
    for (k = 0; k < SC_SCENES; ++k) hash_example(sc_scenes[k]);
    for (k = 0; stress_fixed(k, &s); ++k)
        for (f = 0; f < STRESS_FORM_COUNT; ++f)
            if ((k + k / 12 + f) % every == 0 && stress_applies(s.family, (stress_form)f))
                hash_scene(s, (stress_form)f);
    return 0;
}
