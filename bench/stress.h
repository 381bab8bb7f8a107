/* stress.h - scenes that try to break a step, and what counts as having survived them.
 *
 * A scene is a family, a law, Young's modulus, Poisson's ratio, a step, a number of steps and a seed; a
 * form is an integrator with its switches. stress_run(scene, form) gives a verdict. Nothing is printed, no
 * clock is read but for the record, and the same scene gives the same verdict.
 *
 * A scene with a body runs twice. First undamped:
 *   energy     Ec = 1/2 w.Mw + Psi(u) - F.u, w the mean velocity over the step, less the motion of the centre
 *              of mass of a free body, computed here from positions alone. It may pass its start by what
 *              rounding makes of Psi and half of S, the largest energy in motion so far: the energy safeguard lets Ec
 *              pass its budget by 0.3 S, its S being taken in the middle of steps. With pieces and blades, the same of the whole body.
 *              Linear bodies by methods that conserve a quadratic form, (p,1,1), Newmark, central difference:
 *              1/2 w.M w + (Psi + Psi-)/2 + (p - 1/2)(u - u-).(f - f-)/2 - F.(u + u-)/2, up or down, by no more
 *              than 1e-9 of its largest so far and what rounding makes: see stress_conserve.
 *   momentum   of free bodies, linear always, angular until a step is rejected and for laws and methods that
 *              keep it at all, within 1e-8 of the largest that a body with the energy S can have, and what
 *              rounding of positions makes of a velocity.
 *   motion     some node moves by a hundredth of the body's size, or else at least half as far as the same body of
 *              linear law does by the same method; a linear one, half as far as by the trapezoidal rule. (Where
 *              a step spans periods, so does the method's inertia: a mode of frequency omega that is kicked
 *              by v swings by v/omega / sqrt(1 + (p - 1/4) h^2 omega^2), of (p,1,1).) What starts in
 *              equilibrium, all at one point, or as its own mirror image by StVK, which cannot tell, counts as MINIMUM.
 * Then damped, with a fortieth of the slowest period for a step or the scene's own where that is larger, and
 * without gravity:
 *   shape      back at rest within a hundredth of the body's length, wherever it is by then. What has hardly any
 *              speed, and a verified local minimum of its own energy (tets that stay inverted) within that distance,
 *              counts as MINIMUM, for which no integrator is to blame: see stress_has_minimum.
 * Calm scenes also say how much energy a swing loses, and how many steps were rejected: at most a hundredth.
 *
 * The families from FALL on go through 6 s of their own steps, in which what others would hide has time to grow:
 *   energy     as above; the work of forces that are added to the right side counts as start. Of linear bodies whose
 *              pins, handles or steps change: 1/2 w.Mw + Psi((u + u-)/2), which no form that they conserve is below,
 *              by no more than 1e-6 S.
 *   momentum   as above, and what those forces change; where pins and handles come and go none.
 * Those that start undistorted and without violence (FALL, DROP, ROLL) are calm. */
#ifndef SFEM_BENCH_STRESS_H
#define SFEM_BENCH_STRESS_H

#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "softfem.h"
#include "../tests/bodies.h"
#include "../tests/linear.h"
#include "../tests/blocks.h"

#if defined(__GNUC__)
#define STRESS_STATIC static __attribute__((unused))
#else
#define STRESS_STATIC static
#endif

/* ---- the list of things to do to a body ---- */

#define STRESS_FAMILIES(X)                                                                         \
    X(CALM, "calm", "a held bar swings under its weight, steps that resolve it; 1e4 steps")        \
    X(TUMBLE, "tumble", "a free bar rotates at 3 rad/s, steps that resolve that; 1e4 steps")       \
    X(HANG, "hang", "a held bar under 9.81 m/s^2, however soft")                                   \
    X(SPIN, "spin", "a free bar, 20 rad/s")                                                        \
    X(KICK, "kick", "every node its own velocity, 10 m/s a component")                             \
    X(POINT, "point", "all nodes at one point")                                                    \
    X(SCATTER, "scatter", "nodes at random places in the bar's box")                               \
    X(INVERT, "invert", "inside out, mirrored through its centre")                                 \
    X(HANDLE, "handle", "a node taken to and fro at 100 m/s, then dropped")                        \
    X(MASS, "mass", "densities 1e6 apart, mixed; kicked, half of them held")                       \
    X(STIFF, "stiff", "moduli 1e6 apart, mixed; kicked, half of them held")                        \
    X(SLIVER, "sliver", "tets of quality down to 1e-6; kicked, half of them held")                 \
    X(SOLID, "solid", "nu = .4999; kicked, half of them held")                                     \
    X(BREAK, "break", "a kicked bar of scattered toughness, edges broken at random besides")       \
    X(BLADE, "blade", "a swinging bar cut by a blade at random, every 50 steps")                   \
    X(MODAL, "modal", "modal body: noisy, redundant, contradicting handles, released at random")   \
    X(STREAM, "stream", "modal body over a link that loses, repeats, delays, damages")             \
    X(EIGEN, "eigen", "modes of slivers, plates, pieces, mixed moduli and masses, odd pins")       \
    X(FALL, "fall", "an unstructured body, quality 0.1 or 0.01, held by its feet, falls; 6 s")     \
    X(DROP, "drop", "a held bar whose end drops by 0.9 of its length; 6 s")                        \
    X(ROLL, "roll", "an unstructured body, quality 0.1 or 0.01, free, 6 rad/s; 6 s")               \
    X(SWAP, "swap", "pins and handles exchanged every half second; 6 s")                           \
    X(UNEVEN, "uneven", "a kicked bar, half of them breaking, in steps of random length; 6 s")     \
    X(PUSH, "push", "forces and impulses added between predict and solve; 6 s")

typedef enum stress_family {
#define STRESS_ENUM(name, text, about) STRESS_##name,
    STRESS_FAMILIES(STRESS_ENUM)
#undef STRESS_ENUM
        STRESS_FAMILY_COUNT
} stress_family;

/* The families that scenes are sampled from: later ones would change what a seed gives. */
#define STRESS_SAMPLED_END (STRESS_EIGEN + 1)

#define STRESS_FORMS(X)                                                                            \
    X(DEFAULT, "default", "(p,q,r), rotated factor, corrected, with the energy safeguard")         \
    X(ONE_SOLVE, "one-solve", "the same with one solve a step, never corrected")                   \
    X(UNGUARDED, "unguarded", "one solve without the energy safeguard")                            \
    X(REST, "rest-pose", "factor of the rest pose, p = 1/4, no safeguard: the source's form")      \
    X(MAJORANT, "majorant", "the isotropic majorant for a factor, safeguarded")                    \
    X(ZSZ, "zsz", "the source's damage law, p as that asks, safeguarded")                          \
    X(KR, "kr-alpha", "KR-alpha, rho_inf 0.8, safeguarded")                                        \
    X(NEWMARK, "newmark", "trapezoidal rule, Newton to convergence")                               \
    X(SEMI, "semi-impl", "the same, one iteration")                                                \
    X(EULER, "b-euler", "backward Euler, Newton")                                                  \
    X(HHT, "hht", "HHT .1, Newton")                                                                \
    X(ALPHA, "gen-alpha", "generalized-alpha, rho_inf .8, Newton")                                 \
    X(BATHE, "bathe", "Bathe, Newton")                                                             \
    X(CENTRAL, "central", "central difference at half its stable step (fewer seconds)")            \
    X(BEYOND, "central h",                                                                         \
      "central difference at the step of the scene, refused beyond its limit")                     \
    X(EXACT, "modal exact", "modal bodies by exact oscillators")                                   \
    X(NAIVE, "modal naive", "modal bodies with (1/4,1/2) and no compliance while held, as printed")

typedef enum stress_form {
#define STRESS_ENUM(name, text, about) STRESS_FORM_##name,
    STRESS_FORMS(STRESS_ENUM)
#undef STRESS_ENUM
        STRESS_FORM_COUNT
} stress_form;

#define STRESS_VERDICTS(X)                                                                         \
    X(PASSED, '+', "passed")                                                                       \
    X(REFUSED, 'r', "refused: the step is beyond the stability limit")                             \
    X(MINIMUM, 'k', "in another minimum of its own energy, at rest")                         \
    X(NOT_FINITE, 'N', "not finite")                                                               \
    X(ENERGY, 'E', "energy above its start")                                                       \
    X(MOMENTUM, 'M', "momentum lost")                                                              \
    X(SHAPE, 'S', "not back at rest")                                                              \
    X(STILL, 'V', "did not move")                                                                  \
    X(LOSSY, 'L', "calm motion lost too much, or too many steps were rejected")                    \
    X(UNCONVERGED, 'C', "did not converge")                                                        \
    X(WRONG, 'W', "wrong result")                                                                  \
    X(ERROR, '!', "an error was returned")

typedef enum stress_verdict {
#define STRESS_ENUM(name, letter, about) STRESS_IS_##name,
    STRESS_VERDICTS(STRESS_ENUM)
#undef STRESS_ENUM
        STRESS_VERDICT_COUNT
} stress_verdict;

typedef struct stress_scene {
    stress_family family;
    sfem_law law;
    double young, poisson, h;
    double quality; /* the least, of an unstructured body */
    int steps;
    uint64_t seed;
    char name[72];
} stress_scene;

typedef struct stress_result {
    stress_verdict verdict;
    double excess;          /* most that Ec was above its start, in S, of what conserves no form; */
    double drift;           /* most that the form has changed, of its largest terms */
    double linear, angular; /* momenta, relative, at worst */
    double shape;           /* of its length, at last */
    double moved;           /* of any node at most, in 6 s, of its length */
    double lost, rejected;  /* energy a swing, of S; share of rejected steps */
    int steps, damped_steps;
    int inverted; /* tets, at last */
    double seconds;
    char why[280];
} stress_result;

#define STRESS_ENERGY_TOLERANCE   0.5
#define STRESS_DRIFT_TOLERANCE    1e-9
#define STRESS_NEWMARK_TOLERANCE  1e-6 /* that of u, v and a: accelerations round more */
#define STRESS_MOMENTUM_TOLERANCE 1e-8
#define STRESS_SHAPE_TOLERANCE    0.01
#define STRESS_LOSS_TOLERANCE     0.01 /* of S, a swing */
#define STRESS_REJECTED_TOLERANCE 0.01 /* of the steps */
#define STRESS_LINEAR_TOLERANCE   1e-6 /* of S */
#define STRESS_DROP_LOAD          0.38 /* length omega^2: the end drops by 0.8 to 1 of it (StVK buckles) */

STRESS_STATIC const char *stress_family_name(int k)
{
#define STRESS_TEXT(name, text, about) text,
    static const char *const names[] = {STRESS_FAMILIES(STRESS_TEXT)};
    return names[k];
}

STRESS_STATIC const char *stress_family_about(int k)
{
#define STRESS_ABOUT(name, text, about) about,
    static const char *const names[] = {STRESS_FAMILIES(STRESS_ABOUT)};
    return names[k];
}

STRESS_STATIC const char *stress_form_name(int k)
{
    static const char *const names[] = {STRESS_FORMS(STRESS_TEXT)};
    return names[k];
}

STRESS_STATIC const char *stress_form_about(int k)
{
    static const char *const names[] = {STRESS_FORMS(STRESS_ABOUT)};
    return names[k];
}

STRESS_STATIC char stress_letter(int k)
{
#define STRESS_LETTER(name, letter, about) letter,
    static const char letters[] = {STRESS_VERDICTS(STRESS_LETTER)};
    return letters[k];
}

STRESS_STATIC const char *stress_verdict_about(int k)
{
    static const char *const names[] = {STRESS_VERDICTS(STRESS_ABOUT)};
    return names[k];
}

/* ---- random numbers ---- */

STRESS_STATIC double stress_uniform(uint64_t *state, double low, double high) { return block_uniform(state, low, high); }

STRESS_STATIC double stress_normal(uint64_t *state)
{
    const double r = sqrt(-2 * log(1 - stress_uniform(state, 0, 1)));
    return r * cos(6.283185307179586 * stress_uniform(state, 0, 1));
}

STRESS_STATIC int stress_below(uint64_t *state, int n)
{
    const int k = (int)stress_uniform(state, 0, n);
    return k < n ? k : n - 1;
}

/* ---- bodies ---- */

enum { STRESS_NODES = 320 };

typedef struct stress_body {
    const stress_scene *scene;
    sfem_mesh mesh;
    sfem_model *model;
    sfem_body *body;
    sfem_int pins[STRESS_NODES], pin_count;
    sfem_damage_def damage;
    int held, broken;
    double centre[3], size, mass, period, gravity;
    double *work;
    double u0[3 * STRESS_NODES], v0[3 * STRESS_NODES], f[3 * STRESS_NODES];
    double start[3 * STRESS_NODES], before[3 * STRESS_NODES];
} stress_body;

STRESS_STATIC void stress_note(stress_result *r, stress_verdict verdict, const char *why)
{
    if (r->verdict != STRESS_IS_PASSED) return; /* the first stands */
    r->verdict = verdict;
    snprintf(r->why, sizeof r->why, "%s", why);
}

/* Puts a node into a tet at distance `near` of its height from a face: one sliver, three fair tets. */
STRESS_STATIC void stress_split(sfem_mesh *mesh, sfem_int tet, double near)
{
    const sfem_int node = mesh->nodes++;
    sfem_int corner[4];
    int c, k;
    memcpy(corner, mesh->tet + 4 * tet, sizeof corner);
    for (c = 0; c < 3; ++c) {
        mesh->x[3 * node + c] = near * mesh->x[3 * corner[0] + c];
        for (k = 1; k < 4; ++k)
            mesh->x[3 * node + c] += (1 - near) / 3 * mesh->x[3 * corner[k] + c];
    }
    for (k = 0; k < 4; ++k) {
        sfem_int *to = mesh->tet + 4 * (k ? mesh->tets++ : tet);
        memcpy(to, corner, sizeof corner);
        to[k] = node; /* k = 0: the face opposite corner 0 and the node near it */
    }
}

STRESS_STATIC int stress_is_unstructured(stress_family family)
{
    return family == STRESS_FALL || family == STRESS_ROLL;
}

/* A body of bodies.h, 2 m long, held by the lower 12 % of that. */
STRESS_STATIC sfem_status stress_scattered_mesh(stress_body *s, sfem_error *err)
{
    double low = 0, high = 0;
    sfem_mesh body;
    sfem_int i;
    sfem_status status = body_scattered(700, s->scene->quality, s->scene->seed, &body, err);
    if (status) return status;
    if (body.nodes > STRESS_NODES || body.tets > 4 * STRESS_NODES) {
        fprintf(stderr, "stress.h: %d nodes, %d tets are more than there is room for\n",
                (int)body.nodes, (int)body.tets);
        exit(2);
    }
    s->mesh.nodes = body.nodes;
    s->mesh.tets = body.tets;
    s->mesh.x = (sfem_real *)malloc(3 * STRESS_NODES * sizeof(sfem_real));
    s->mesh.tet = (sfem_int *)malloc(16 * STRESS_NODES * sizeof(sfem_int));
    memcpy(s->mesh.x, body.x, 3 * (size_t)body.nodes * sizeof(sfem_real));
    memcpy(s->mesh.tet, body.tet, 4 * (size_t)body.tets * sizeof(sfem_int));
    sfem_mesh_free(&body);
    for (i = 0; i < s->mesh.nodes; ++i) {
        low = fmin(low, s->mesh.x[3 * i]);
        high = fmax(high, s->mesh.x[3 * i]);
    }
    s->size = high - low;
    for (i = 0; i < s->mesh.nodes; ++i)
        if (s->mesh.x[3 * i] < low + 0.12 * s->size) s->pins[s->pin_count++] = i;
    return SFEM_OK;
}

STRESS_STATIC sfem_status stress_mesh(stress_body *s, uint64_t *random, sfem_error *err)
{
    static const sfem_int cells[3] = {5, 2, 2};
    static const sfem_real size[3] = {0.5, 0.2, 0.2};
    sfem_status status;
    sfem_mesh block;
    sfem_int i;
    if (stress_is_unstructured(s->scene->family)) return stress_scattered_mesh(s, err);
    status = sfem_mesh_block(cells, size, SFEM_CELL_5_TETS, NULL, &block, err);
    if (status) return status;
    s->mesh = block;
    s->mesh.x = (sfem_real *)malloc(3 * STRESS_NODES * sizeof(sfem_real));
    s->mesh.tet = (sfem_int *)malloc(16 * STRESS_NODES * sizeof(sfem_int));
    s->mesh.region = NULL;
    memcpy(s->mesh.x, block.x, 3 * (size_t)block.nodes * sizeof(sfem_real));
    memcpy(s->mesh.tet, block.tet, 4 * (size_t)block.tets * sizeof(sfem_int));
    sfem_mesh_free(&block);
    s->pin_count = block_clamp(cells, s->pins);
    block_jitter(&s->mesh, 0.01, random);
    for (i = 0; i < 3; ++i) s->centre[i] = size[i] / 2;
    s->size = size[0];
    if (s->scene->family == STRESS_SLIVER)
        for (i = 0; i < 6; ++i) /* quality about .6, .. down to 1e-6 */
            stress_split(&s->mesh, 3 + 15 * i, pow(10, -1.0 - i));
    return SFEM_OK;
}

STRESS_STATIC sfem_status stress_model(stress_body *s, uint64_t *random, sfem_error *err)
{
    const stress_scene *scene = s->scene;
    sfem_model_def def = linear_model_def();
    sfem_material material[2];
    sfem_int index[4 * STRESS_NODES], i;
    material[0] = linear_material();
    material[0].law = scene->law;
    material[0].young = scene->young;
    material[0].poisson = scene->poisson;
    material[1] = material[0];
    if (scene->family == STRESS_MASS) material[0].density = 1, material[1].density = 1e6;
    if (scene->family == STRESS_STIFF)
        material[0].young = scene->young * 1e-3, material[1].young = scene->young * 1e3;
    for (i = 0; i < s->mesh.tets; ++i) index[i] = stress_below(random, 2);
    def.mesh = &s->mesh;
    def.materials = material;
    def.material_count = 2;
    def.tet_material = index;
    return sfem_model_create(&def, &s->model, err);
}

/* The slowest period, s; that of a rod where it cannot be computed. */
STRESS_STATIC double stress_period(const stress_body *s)
{
    sfem_modes_def def = sfem_default_modes_def();
    sfem_modes modes;
    double period = 2 * s->size / sqrt(s->scene->young / 1000);
    def.modes = 1;
    def.pins = s->pins;
    def.pin_count = s->held ? s->pin_count : 0;
    if (sfem_modes_create(s->model, &def, &modes, NULL)) return period;
    if (modes.lambda[0] > 0) period = 6.283185307179586 / sqrt(modes.lambda[0]);
    sfem_modes_free(&modes);
    return period;
}

STRESS_STATIC int stress_is_held(const stress_scene *s)
{
    switch (s->family) {
    case STRESS_CALM:
    case STRESS_HANG:
    case STRESS_FALL:
    case STRESS_DROP:
    case STRESS_SWAP:
        return 1;
    case STRESS_HANDLE:
    case STRESS_MASS:
    case STRESS_STIFF:
    case STRESS_SLIVER:
    case STRESS_SOLID:
    case STRESS_BREAK:
    case STRESS_BLADE:
    case STRESS_PUSH:
        return (int)(s->seed % 2);
    case STRESS_UNEVEN:
        return (int)(s->seed / 2 % 2);
    default:
        return 0;
    }
}

STRESS_STATIC sfem_body_def stress_def(const stress_body *s, stress_form form, double h)
{
    sfem_body_def def = sfem_default_body_def();
    (void)h;
    if (s->held) def.pins = s->pins, def.pin_count = s->pin_count;
    def.max_handles = 2;
    def.handle_compliance = 0;
    if (s->broken) def.damage = &s->damage;
    switch (form) {
    case STRESS_FORM_ONE_SOLVE:
        def.accuracy = 1;
        break;
    case STRESS_FORM_UNGUARDED:
        def.accuracy = 1;
        def.safeguard = 0;
        break;
    case STRESS_FORM_REST:
        def.accuracy = 1;
        def.safeguard = 0;
        def.frame = SFEM_FRAME_REST;
        def.p = 0.25;
        break;
    case STRESS_FORM_MAJORANT:
        def.frame = SFEM_FRAME_ISOTROPIC;
        break;
    case STRESS_FORM_KR:
        def.integrator = SFEM_KR_ALPHA;
        break;
    case STRESS_FORM_SEMI:
        def.newton.iterations = 1; /* fall through */
    case STRESS_FORM_NEWMARK:
        def.integrator = SFEM_NEWMARK;
        break;
    case STRESS_FORM_EULER:
        def.integrator = SFEM_BACKWARD_EULER;
        break;
    case STRESS_FORM_HHT:
        def.integrator = SFEM_HHT;
        break;
    case STRESS_FORM_ALPHA:
        def.integrator = SFEM_GENERALIZED_ALPHA;
        break;
    case STRESS_FORM_BATHE:
        def.integrator = SFEM_BATHE;
        break;
    case STRESS_FORM_CENTRAL:
    case STRESS_FORM_BEYOND:
        def.integrator = SFEM_CENTRAL;
        break;
    default:
        break;
    }
    if (form > STRESS_FORM_SEMI && form <= STRESS_FORM_BATHE) def.newton.iterations = 100;
    if (form == STRESS_FORM_NEWMARK) def.newton.iterations = 100;
    return def;
}

STRESS_STATIC int stress_is_newton(stress_form form)
{
    return form >= STRESS_FORM_NEWMARK && form <= STRESS_FORM_BATHE;
}

/* Which forms mean anything to a family. */
STRESS_STATIC int stress_applies(stress_family family, stress_form form)
{
    const int breaks = family == STRESS_BREAK || family == STRESS_BLADE;
    const int modal = family >= STRESS_MODAL && family <= STRESS_EIGEN;
    if (family >= STRESS_FALL) return form <= STRESS_FORM_ONE_SOLVE;
    if (modal)
        return form == STRESS_FORM_DEFAULT || (family == STRESS_MODAL && form >= STRESS_FORM_EXACT);
    if (form >= STRESS_FORM_EXACT) return 0;
    if (breaks)
        return form <= STRESS_FORM_REST || form == STRESS_FORM_ZSZ || form == STRESS_FORM_CENTRAL;
    return form != STRESS_FORM_ZSZ;
}

STRESS_STATIC void stress_free(stress_body *s)
{
    sfem_body_free(s->body);
    sfem_model_free(s->model);
    free(s->mesh.x);
    free(s->mesh.tet);
    free(s->work);
    memset(s, 0, sizeof *s);
}

STRESS_STATIC sfem_status stress_build(const stress_scene *scene, stress_form form,
                                       uint64_t *random, stress_body *s, sfem_error *err)
{
    sfem_status status;
    memset(s, 0, sizeof *s);
    s->scene = scene;
    s->held = stress_is_held(scene);
    status = stress_mesh(s, random, err);
    if (!status) status = stress_model(s, random, err);
    if (status) return status;
    s->work = (double *)malloc(sfem_model_work_size(s->model) * sizeof *s->work);
    s->mass = sfem_model_total_mass(s->model);
    s->period = stress_period(s);
    s->gravity = scene->family == STRESS_HANG || scene->family == STRESS_FALL ? 9.81 : 0;
    if (scene->family == STRESS_DROP)
        s->gravity = STRESS_DROP_LOAD * s->size * pow(6.283185307179586 / s->period, 2);
    if (scene->family == STRESS_CALM) /* sags by a fiftieth of its length, g/omega^2 or so */
        s->gravity = 0.02 * s->size * pow(6.283185307179586 / s->period, 2);
    s->broken = scene->family == STRESS_BREAK || scene->family == STRESS_BLADE ||
                (scene->family == STRESS_UNEVEN && scene->seed % 2);
    s->damage = sfem_default_damage_def();
    s->damage.weibull = 3;
    s->damage.seed = scene->seed;
    if (form == STRESS_FORM_ZSZ || (scene->family == STRESS_UNEVEN && scene->seed % 4 == 3))
        s->damage.law = SFEM_DAMAGE_ZSZ;
    /* what a kick of 10 m/s could pay for a few times over: 1/2 rho v^2 a cell */
    s->damage.toughness = scene->family == STRESS_BLADE ? 1e12 : 0.02 * 500 * 300 * 0.1;
    return SFEM_OK;
}

STRESS_STATIC void stress_cross(const double *a, const double *b, double *out)
{
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

/* u0, v0 */
STRESS_STATIC void stress_state(stress_body *s, uint64_t *random)
{
    const stress_family family = s->scene->family;
    const int spins = family == STRESS_SPIN || family == STRESS_TUMBLE || family == STRESS_BLADE ||
                      family == STRESS_ROLL || family == STRESS_SWAP || family == STRESS_PUSH;
    double spin[3] = {0, 0, 20}, r[3];
    sfem_int i;
    int c;
    if (family == STRESS_TUMBLE || family == STRESS_BLADE) spin[0] = 1, spin[1] = 2, spin[2] = 2;
    if (family >= STRESS_FALL) spin[2] = 6;
    if (family == STRESS_TUMBLE) /* 1e-2 of the slowest mode, so that it hardly stretches */
        for (c = 0; c < 3; ++c) spin[c] = fmin(spin[c], 0.05 * 6.28 / s->period);
    for (i = 0; i < s->mesh.nodes; ++i) {
        double *u = s->u0 + 3 * i, *v = s->v0 + 3 * i;
        for (c = 0; c < 3; ++c) r[c] = s->mesh.x[3 * i + c] - s->centre[c];
        if (spins) stress_cross(spin, r, v);
        for (c = 0; c < 3; ++c) {
            switch (family) {
            case STRESS_KICK:
            case STRESS_MASS:
            case STRESS_STIFF:
            case STRESS_SLIVER:
            case STRESS_SOLID:
            case STRESS_BREAK:
            case STRESS_UNEVEN:
                v[c] = 10 * stress_normal(random);
                break;
            case STRESS_POINT:
                u[c] = -r[c];
                break;
            case STRESS_SCATTER:
                u[c] = 2 * s->centre[c] * stress_uniform(random, -0.5, 0.5) - r[c];
                break;
            case STRESS_INVERT:
                u[c] = -2 * r[c];
                break;
            default:
                break;
            }
        }
    }
    for (i = 0; s->held && i < s->pin_count; ++i)
        for (c = 0; c < 3; ++c) s->u0[3 * s->pins[i] + c] = s->v0[3 * s->pins[i] + c] = 0;
}

/* ---- what is watched ---- */

typedef struct stress_watch {
    double start, scale, largest; /* Ec at the start; kinetic + elastic: now, at most */
    double p0[3], l0[3];          /* momenta at the start */
    double moved;                 /* of any node, at most */
    double form, terms,
        rounding,   /* of stress_conserve: at first, its largest terms, a step's rounding, */
        evaluation; /* and that of Psi itself */
    int counted;    /* steps, of the same */
    int still;      /* it starts at rest in equilibrium */
    double ahead;   /* work of added forces over the second half of the step */
} stress_watch;

/* Ec and both momenta of mean velocity (u - before)/h at u. */
STRESS_STATIC double stress_measure(stress_body *s, const double *u, const double *before, double h,
                                    stress_watch *w, double p[3], double l[3])
{
    const double *mass = sfem_model_node_mass(s->model);
    double kinetic = 0, load = 0, psi, place = 0;
    sfem_int i;
    int c;
    memset(p, 0, 3 * sizeof *p);
    memset(l, 0, 3 * sizeof *l);
    psi = s->broken && s->body && u == sfem_body_displacement(s->body)
              ? sfem_body_energy(s->body).elastic
              : sfem_model_forces(s->model, u, SFEM_DOUBLE, s->f, NULL, NULL, s->work, NULL);
    for (i = 0; i < s->mesh.nodes; ++i) {
        double x[3], m[3], t[3];
        for (c = 0; c < 3; ++c) {
            const double v = (u[3 * i + c] - before[3 * i + c]) / h;
            x[c] = s->mesh.x[3 * i + c] + u[3 * i + c];
            m[c] = mass[i] * v;
            kinetic += m[c] * v / 2;
            p[c] += m[c];
        }
        load += mass[i] * s->gravity * u[3 * i + 1];
        place += mass[i] * u[3 * i + 1];
        stress_cross(x, m, t);
        for (c = 0; c < 3; ++c) l[c] += t[c];
    }
    if (!s->held) {
        for (c = 0; c < 3; ++c) kinetic -= p[c] * p[c] / (2 * s->mass);
        load -= s->gravity * place;
    }
    w->scale = kinetic + psi;
    return kinetic + psi + load;
}

STRESS_STATIC double stress_norm3(const double *a, const double *b)
{
    double sum = 0;
    int c;
    for (c = 0; c < 3; ++c) sum += (a[c] - b[c]) * (a[c] - b[c]);
    return sqrt(sum);
}

STRESS_STATIC void stress_begin(stress_body *s, stress_watch *w, double h)
{
    const double *mass = sfem_model_node_mass(s->model);
    sfem_int i;
    double most = 0;
    memset(w, 0, sizeof *w);
    for (i = 0; i < 3 * s->mesh.nodes; ++i) s->before[i] = s->u0[i] - h * s->v0[i];
    memcpy(s->start, s->u0, sizeof s->start);
    w->start = stress_measure(s, s->u0, s->before, h, w, w->p0, w->l0);
    w->largest = w->scale;
    (void)sfem_model_forces(s->model, s->u0, SFEM_DOUBLE, s->f, NULL, NULL, s->work, NULL);
    for (i = 0; i < 3 * s->mesh.nodes; ++i)
        most = fmax(most, fmax(fabs(s->f[i]) / (s->scene->young * 0.01), fabs(s->v0[i])));
    w->still = most < 1e-9 && s->gravity == 0 && s->scene->family != STRESS_HANDLE;
    for (i = 0; s->held && i < s->mesh.nodes; ++i)
        w->largest += h * h / 2 * mass[i] * s->gravity * s->gravity;
}

/* Does it conserve a quadratic form exactly? */
STRESS_STATIC int stress_conserves(const stress_body *s, stress_form form)
{
    return s->scene->law == SFEM_LINEAR && !s->broken && s->scene->family < STRESS_FALL &&
           (form <= STRESS_FORM_MAJORANT || form == STRESS_FORM_NEWMARK ||
            form == STRESS_FORM_SEMI || form == STRESS_FORM_CENTRAL || form == STRESS_FORM_BEYOND);
}

/* What rounding of u makes of Psi: eps sum |K| u^2, |K| by its diagonal. Of a body in equilibrium, all that there is. */
STRESS_STATIC double stress_rounding(const stress_body *s, const double *u)
{
    const sfem_matrix *k = sfem_model_stiffness(s->model);
    double sum = 0;
    sfem_int i;
    for (i = 0; i < 3 * s->mesh.nodes; ++i)
        sum += k->val[9 * ((size_t)k->row[i / 3 + 1] - 1) + (size_t)(i % 3 * 4)] * u[i] * u[i];
    return 2.3e-16 * sum;
}

/* The quadratic form that (p,1,1), which is Newmark(p, 1/2), conserves, from two positions and the forces there;
 * of a free body without the motion of its centre. Rounding of u and w to eps changes it in a step by some
 *   eps (sum |u| (m |w|/h + 2 |f|) + p h^2 sum |w| |K| |w|),   |K| by its diagonal,
 * the latter since A w is that large in the solve, and in n steps by sqrt(n) of that, or eight times as much:
 * 1e-15 of the whole in most scenes, 1e-6 where slivers or moduli make h omega 1e5. Psi itself is
 * taken to eps sum |K| u^2, by slivers far above Psi. */
STRESS_STATIC void stress_conserve(stress_body *s, stress_form form, const double *u, double h,
                                   stress_watch *w, stress_result *r)
{
    const double *mass = sfem_model_node_mass(s->model), p = sfem_body_get_info(s->body).p;
    const sfem_matrix *k = sfem_model_stiffness(s->model);
    double at[2][3 * STRESS_NODES], f[2][3 * STRESS_NODES], psi[2], c[2][3] = {{0}};
    double now = 0, load = 0, rounding = 0, allowed;
    const size_t n = 3 * (size_t)s->mesh.nodes;
    size_t i;
    int t;
    memcpy(at[0], s->before, n * sizeof(double));
    memcpy(at[1], u, n * sizeof(double));
    for (t = 0; t < 2; ++t) {
        for (i = 0; !s->held && i < n; ++i) c[t][i % 3] += mass[i / 3] * at[t][i] / s->mass;
        for (i = 0; i < n; ++i) at[t][i] -= c[t][i % 3];
        psi[t] = sfem_model_forces(s->model, at[t], SFEM_DOUBLE, f[t], NULL, NULL, s->work, NULL);
        now += psi[t] / 2;
    }
    for (i = 0; i < n; ++i) {
        const double d = at[1][i] - at[0][i], m = mass[i / 3], v = (u[i] - s->before[i]) / h;
        const double kii = k->val[9 * ((size_t)k->row[i / 3 + 1] - 1) + i % 3 * 4];
        now += m * d * d / (2 * h * h) + (p - 0.5) / 2 * d * (f[1][i] - f[0][i]);
        if (s->held && i % 3 == 1) load += m * s->gravity * (u[i] + s->before[i]) / 2;
        rounding += fabs(u[i]) * (m * fabs(v) / h + 2 * fabs(f[1][i])) + p * h * h * kii * v * v;
    }
    if (!w->counted++) w->form = now + load;
    w->terms = fmax(w->terms, now);
    w->evaluation = fmax(w->evaluation, stress_rounding(s, at[1]));
    w->rounding = fmax(w->rounding, 2.3e-16 * rounding);
    allowed =
        (form <= STRESS_FORM_MAJORANT || form >= STRESS_FORM_CENTRAL ? STRESS_DRIFT_TOLERANCE
                                                                     : STRESS_NEWMARK_TOLERANCE) *
            w->terms +
        8 * sqrt(w->counted) * w->rounding + w->evaluation;
    if (w->terms > 0) r->drift = fmax(r->drift, fabs(now + load - w->form) / w->terms);
    if (!(fabs(now + load - w->form) <= allowed)) {
        char why[128];
        snprintf(why, sizeof why,
                 "what a linear body conserves is off by %.3g of it after %d steps", r->drift,
                 r->steps);
        stress_note(r, STRESS_IS_ENERGY, why);
    }
}

/* Angular momentum is kept: of laws that know rotations, by methods that take forces where they are. */
STRESS_STATIC int stress_keeps_angular(const stress_body *s, stress_form form)
{
    if (s->scene->law == SFEM_LINEAR || s->scene->family == STRESS_PUSH) return 0;
    return form == STRESS_FORM_DEFAULT || form == STRESS_FORM_UNGUARDED ||
           form == STRESS_FORM_CENTRAL || form == STRESS_FORM_BEYOND;
}

/* Psi((u + u-)/2) - Psi(u) */
STRESS_STATIC double stress_middle(stress_body *s, const double *u)
{
    double middle[3 * STRESS_NODES];
    sfem_int i;
    for (i = 0; i < 3 * s->mesh.nodes; ++i) middle[i] = (u[i] + s->before[i]) / 2;
    return sfem_model_elastic_energy(s->model, middle) - sfem_model_elastic_energy(s->model, u);
}

/* The energy with Psi at the middle of the step counts, not at its end. */
STRESS_STATIC int stress_is_middle(const stress_scene *s)
{
    return s->law == SFEM_LINEAR && s->family >= STRESS_SWAP;
}

/* Linear bodies whose pins, handles or steps change, while no force is added. */
STRESS_STATIC int stress_is_bounded(const stress_scene *s)
{
    return s->law == SFEM_LINEAR && (s->family == STRESS_SWAP || s->family == STRESS_UNEVEN);
}

STRESS_STATIC double stress_energy_tolerance(const stress_scene *s)
{
    return stress_is_bounded(s) ? STRESS_LINEAR_TOLERANCE : STRESS_ENERGY_TOLERANCE;
}

/* After a step: energy and momenta. Returns 0 if the run has to end. */
STRESS_STATIC int stress_check(stress_body *s, stress_form form, stress_watch *w, double h,
                               stress_result *r)
{
    const double *u = sfem_body_displacement(s->body);
    double p[3], l[3], e, allowed, reach = 0, push, noise;
    sfem_int i;
    e = stress_measure(s, u, s->before, h, w, p, l);
    if (stress_is_middle(s->scene) && !s->broken)
        e += stress_middle(s, u);
    else
        e -= w->ahead;
    if (!isfinite(e)) {
        stress_note(r, STRESS_IS_NOT_FINITE, "energy");
        return 0;
    }
    /* a run that grows is compared with what it had, not with itself */
    if (e - w->start <= w->largest) w->largest = fmax(w->largest, fmin(w->scale, 2 * w->largest));
    if (stress_conserves(s, form))
        stress_conserve(s, form, u, h, w, r);
    else if (w->largest > 0)
        r->excess = fmax(r->excess, (e - w->start - stress_rounding(s, u)) / w->largest);
    if (r->excess > stress_energy_tolerance(s->scene)) {
        snprintf(r->why, sizeof r->why, "%.3g S above its start after %d steps", r->excess,
                 r->steps);
        if (r->verdict == STRESS_IS_PASSED) r->verdict = STRESS_IS_ENERGY;
        return r->excess < 1e3; /* how far it goes */
    }
    for (i = 0; i < 3 * s->mesh.nodes; ++i) {
        w->moved = fmax(w->moved, fabs(u[i] - s->start[i]));
        reach = fmax(reach, fabs(s->mesh.x[i] + u[i]));
    }
    if (s->held || s->gravity > 0) return 1;
    noise = 4.5e-16 * s->mass * reach / h;
    push = sqrt(2 * s->mass * w->largest) + stress_norm3(w->p0, (const double[3]){0, 0, 0}) + noise;
    allowed = STRESS_MOMENTUM_TOLERANCE;
    r->linear = fmax(r->linear, (stress_norm3(p, w->p0) - noise) / push);
    if (stress_keeps_angular(s, form) && sfem_body_get_info(s->body).rejected == 0)
        r->angular = fmax(r->angular, (stress_norm3(l, w->l0) / (reach + s->size) - noise) / push);
    if (!(r->linear <= allowed && r->angular <= allowed)) {
        char why[96];
        snprintf(why, sizeof why, "off by %.2g (linear), %.2g (angular) after %d steps", r->linear,
                 r->angular, r->steps);
        stress_note(r, STRESS_IS_MOMENTUM, why);
    }
    return 1;
}

/* The largest distance from the rest shape, best rotated and moved, over the body's length; of a linear body,
 * which knows no rotations, the root mean square strain. */
STRESS_STATIC double stress_misshape(stress_body *s)
{
    const double *mass = sfem_model_node_mass(s->model);
    double x[3 * STRESS_NODES], c[3] = {0, 0, 0}, d[3] = {0, 0, 0}, a[9] = {0}, q[9], most = 0;
    sfem_int i;
    int j, k;
    if (s->scene->law == SFEM_LINEAR)
        return sqrt(2 * sfem_model_elastic_energy(s->model, sfem_body_displacement(s->body)) /
                    (s->scene->young * 0.02));
    sfem_body_positions(s->body, x);
    for (i = 0; i < 3 * s->mesh.nodes; ++i) {
        c[i % 3] += mass[i / 3] * x[i] / s->mass;
        d[i % 3] += mass[i / 3] * s->mesh.x[i] / s->mass;
    }
    for (i = 0; i < s->mesh.nodes; ++i)
        for (j = 0; j < 3; ++j)
            for (k = 0; k < 3; ++k)
                a[3 * j + k] += mass[i] * (x[3 * i + j] - c[j]) * (s->mesh.x[3 * i + k] - d[k]);
    sfem_polar(a, q, NULL);
    for (i = 0; i < s->mesh.nodes; ++i) {
        double away[3];
        for (j = 0; j < 3; ++j) {
            away[j] = x[3 * i + j] - c[j];
            for (k = 0; k < 3; ++k) away[j] -= q[3 * j + k] * (s->mesh.x[3 * i + k] - d[k]);
        }
        most = fmax(most, sqrt(away[0] * away[0] + away[1] * away[1] + away[2] * away[2]));
    }
    return most / s->size;
}

STRESS_STATIC void stress_failed(stress_result *r, const sfem_error *err)
{
    stress_note(r,
                err->status == SFEM_UNSTABLE        ? STRESS_IS_REFUSED
                : err->status == SFEM_NOT_CONVERGED ? STRESS_IS_UNCONVERGED
                : err->status == SFEM_NOT_SPD       ? STRESS_IS_UNCONVERGED
                : err->status == SFEM_NOT_FINITE    ? STRESS_IS_NOT_FINITE
                                                    : STRESS_IS_ERROR,
                err->text);
}

/* ---- what is done while it runs ---- */

typedef struct stress_deed {
    sfem_int handle;
    int holding;
    double target[3], home[3], velocity[3];
} stress_deed;

/* The node at the far end: 100 m/s to and fro, within three lengths of the body, for a quarter of the run. */
STRESS_STATIC sfem_status stress_wield(stress_body *s, stress_deed *d, int step, double h,
                                       uint64_t *random, sfem_error *err)
{
    int c;
    sfem_status status;
    double away = 0;
    if (step == 0) {
        status = sfem_body_grab_node(s->body, s->mesh.nodes - 1, &d->handle, err);
        if (status) return status;
        sfem_body_handle_position(s->body, d->handle, d->home);
        memcpy(d->target, d->home, sizeof d->target);
        d->holding = 1;
    }
    if (!d->holding) return SFEM_OK;
    for (c = 0; c < 3; ++c) away += (d->target[c] - d->home[c]) * d->velocity[c];
    if (step == 0 || away > 100 * 3 * s->size || stress_below(random, 40) == 0) {
        double n = 0;
        for (c = 0; c < 3; ++c) {
            d->velocity[c] = stress_normal(random) - (away > 0 ? d->target[c] - d->home[c] : 0);
            n += d->velocity[c] * d->velocity[c];
        }
        for (c = 0; c < 3; ++c) d->velocity[c] *= 100 / sqrt(n);
    }
    for (c = 0; c < 3; ++c) d->target[c] += h * d->velocity[c];
    return sfem_body_move_handle(s->body, d->handle, d->target, err);
}

/* Is it where it was sent? */
STRESS_STATIC void stress_held_where(stress_body *s, const stress_deed *d, stress_result *r)
{
    double x[3];
    sfem_body_handle_position(s->body, d->handle, x);
    if (!(stress_norm3(x, d->target) <= 1e-9 * (s->size + stress_norm3(d->target, d->home))))
        stress_note(r, STRESS_IS_WRONG, "the handle is not at its target");
}

STRESS_STATIC sfem_status stress_damage(stress_body *s, int step, uint64_t *random, sfem_error *err)
{
    if (s->scene->family != STRESS_BLADE && step % 20 == 10) {
        const sfem_int *tet = s->mesh.tet + 4 * stress_below(random, (int)s->mesh.tets);
        const int a = stress_below(random, 4);
        return sfem_body_break_edge(s->body, tet[a], tet[(a + 1) % 4], err);
    }
    if (s->scene->family == STRESS_BLADE && step % 50 == 10 && step < 500) {
        double x[3 * STRESS_NODES], blade[2][9];
        const int at = stress_below(random, (int)s->mesh.nodes);
        int k;
        sfem_body_positions(s->body, x);
        for (k = 0; k < 9; ++k) {
            blade[0][k] = x[3 * at + k % 3] + 0.3 * stress_normal(random);
            blade[1][k] = blade[0][k];
        }
        for (k = 0; k < 9; ++k) blade[1][k] += 0.1 * stress_normal(random);
        return sfem_body_cut(s->body, blade[0], blade[1], NULL, err);
    }
    return SFEM_OK;
}

/* How far the farthest node of the same body goes if it is of linear law, whole, by the same method and p;
 * of a body that is linear itself, by the trapezoidal rule. */
STRESS_STATIC double stress_twin(const stress_body *s, stress_form form, double h, int steps)
{
    const stress_form by = s->scene->law == SFEM_LINEAR ? STRESS_FORM_NEWMARK : form;
    stress_scene scene = *s->scene;
    uint64_t random = scene.seed * 0x9e3779b97f4a7c15u + 12345;
    double moved = 0;
    stress_body twin;
    sfem_body_def def;
    sfem_error err;
    sfem_status status;
    int k, i;
    scene.law = SFEM_LINEAR;
    status = stress_build(&scene, by, &random, &twin, &err);
    twin.broken = 0;
    if (!status) {
        stress_state(&twin, &random);
        def = stress_def(&twin, by, h);
        def.gravity[1] = -twin.gravity;
        if (def.integrator == SFEM_PQR) def.p = sfem_body_get_info(s->body).p;
        status = sfem_body_create(twin.model, &def, &twin.body, &err);
    }
    if (!status) status = sfem_body_set_state(twin.body, twin.u0, twin.v0, &err);
    for (k = 0; k < steps && !status && moved < 0.02 * s->size; ++k) {
        status = sfem_body_step(twin.body, h, &err);
        for (i = 0; i < 3 * twin.mesh.nodes; ++i)
            moved = fmax(moved, fabs(sfem_body_displacement(twin.body)[i] - twin.u0[i]));
    }
    stress_free(&twin);
    return status ? INFINITY : moved;
}

/* Did some node move as far as it should? */
STRESS_STATIC void stress_ask_motion(const stress_body *s, stress_form form, const stress_watch *w,
                                     stress_result *r)
{
    const double far = 0.01 * s->size;
    double least = far;
    char why[128];
    if (r->verdict != STRESS_IS_PASSED || w->moved >= far) return;
    if (!w->still) least = fmin(far, 0.5 * stress_twin(s, form, s->scene->h, r->steps));
    snprintf(why, sizeof why, "moved by %.3g m, at least %.3g wanted%s", w->moved, least,
             w->still ? ", of a body that starts in equilibrium" : "");
    if (!(w->moved >= least)) stress_note(r, w->still ? STRESS_IS_MINIMUM : STRESS_IS_STILL, why);
}

/* Work in all is bounded, by the forces that it takes: a run of the implicit methods, or one that does all its
 * steps again, may be shorter. */
#define STRESS_ITERATIONS 2500
#define STRESS_DESCENTS   200000

/* The undamped part. */
STRESS_STATIC void stress_violence(stress_body *s, stress_form form, double h, uint64_t *random,
                                   stress_result *r)
{
    const int wield = s->scene->family == STRESS_HANDLE ? s->scene->steps / 4 : 0;
    const int alone = wield + stress_is_newton(form);
    stress_watch w;
    stress_deed deed;
    sfem_error err;
    int64_t iterations = 0;
    double swing[2] = {0, 0}, per_swing = s->period / h;
    int count[2] = {0, 0}, k;
    memset(&deed, 0, sizeof deed);
    stress_begin(s, &w, h);
    for (k = 0; k < s->scene->steps && iterations < STRESS_ITERATIONS &&
                sfem_body_get_info(s->body).solves < STRESS_DESCENTS;
         ++k) {
        sfem_status status = SFEM_OK;
        if (k < wield) status = stress_wield(s, &deed, k, h, random, &err);
        if (wield && k == wield) sfem_body_release_handle(s->body, deed.handle);
        if (s->broken && !status) status = stress_damage(s, k, random, &err);
        memcpy(s->before, sfem_body_displacement(s->body),
               3 * (size_t)s->mesh.nodes * sizeof(double));
        if (status == SFEM_BAD_ARGUMENT) status = SFEM_OK; /* no such edge */
        if (!status) status = sfem_body_step(s->body, h, &err);
        if (status) {
            char at[32];
            stress_failed(r, &err);
            snprintf(at, sizeof at, " (step %d)", k);
            strncat(r->why, at, sizeof r->why - strlen(r->why) - 1);
            break;
        }
        r->steps = k + 1;
        if (stress_is_newton(form)) iterations += sfem_body_newton(s->body).iterations;
        if (k < wield) {
            stress_held_where(s, &deed, r);
            /* from the last of these on it is left alone */
            w.start =
                stress_measure(s, sfem_body_displacement(s->body), s->before, h, &w, w.p0, w.l0);
            w.largest = w.scale;
            continue;
        }
        /* momenta from the first step that no hand touched: in the implicit methods' first one their
         * acceleration at its start is still that of the hand */
        if (wield && k <= alone)
            stress_measure(s, sfem_body_displacement(s->body), s->before, h, &w, w.p0, w.l0);
        if (wield && k < alone) continue;
        /* what is linear and damped by the method may swing higher than when it was let go */
        if (wield && k < wield + 100 && s->scene->law == SFEM_LINEAR &&
            !stress_conserves(s, form)) {
            double p[3], l[3];
            w.start = fmax(w.start, stress_measure(s, sfem_body_displacement(s->body), s->before, h,
                                                   &w, p, l));
        }
        if (!stress_check(s, form, &w, h, r)) break;
        if (per_swing <
            s->scene->steps / 4) { /* mean energies in motion of the first and last swings */
            const int which = k < 2 * per_swing ? 0 : k >= s->scene->steps - 2 * per_swing ? 1 : -1;
            if (which >= 0) {
                double p[3], l[3], load = 0;
                const double e =
                    stress_measure(s, sfem_body_displacement(s->body), s->before, h, &w, p, l);
                (void)load;
                swing[which] += e;
                ++count[which];
            }
        }
    }
    r->rejected = r->steps ? (double)sfem_body_get_info(s->body).rejected / r->steps : 0;
    if (count[0] && count[1])
        r->lost =
            (swing[0] / count[0] - swing[1] / count[1]) / (w.largest * (r->steps / per_swing));
    if (s->scene->family <= STRESS_TUMBLE && count[1] &&
        !(r->lost <= STRESS_LOSS_TOLERANCE && r->rejected <= STRESS_REJECTED_TOLERANCE)) {
        char why[96];
        snprintf(why, sizeof why, "%.3g of S lost a swing, %.3g of the steps rejected", r->lost,
                 r->rejected);
        stress_note(r, STRESS_IS_LOSSY, why);
    }
    stress_ask_motion(s, form, &w, r);
}

/* K(u) + shift M and its factor: exact tangents, pinned axes made stiff. Returns its negative pivots, -1 without. */
STRESS_STATIC int stress_pivots(const stress_body *s, const double *u, double shift, sfem_matrix *k,
                                sfem_ldl **ldl)
{
    sfem_ldl_def def = sfem_default_ldl_def();
    double largest = 0;
    sfem_int i;
    int c;
    sfem_model_tangent(s->model, u, SFEM_TANGENT_EXACT, k, NULL);
    for (i = 0; i < k->n; ++i)
        for (c = 0; c < 9; c += 4) {
            double *diagonal = &k->val[9 * ((size_t)k->row[i + 1] - 1) + (size_t)c];
            *diagonal += shift * sfem_model_node_mass(s->model)[i];
            largest = fmax(largest, fabs(*diagonal));
        }
    for (i = 0; s->held && i < s->pin_count; ++i)
        for (c = 0; c < 9; c += 4)
            k->val[9 * ((size_t)k->row[s->pins[i] + 1] - 1) + (size_t)c] += 1e6 * largest;
    def.positive = 0;
    if (*ldl ? sfem_ldl_refactor(*ldl, k, NULL) : sfem_ldl_create(&def, k, ldl, NULL)) return -1;
    return (int)sfem_ldl_get_info(*ldl).negative;
}

/* Is a minimum of the energy within a hundredth of its length, where it hardly moves? Newton's iteration, undamped and
 * by exact tangents, goes there, no eigenvalue being below -1e-3 of the lowest at rest anywhere on the way [by
 * Sylvester's law], and ends within 1e-9 of its length. *far: the way there. */
STRESS_STATIC int stress_has_minimum(stress_body *s, double *far)
{
    const double shift = 1e-3 * pow(6.283185307179586 / s->period, 2);
    const size_t n = 3 * (size_t)s->mesh.nodes;
    sfem_matrix k = *sfem_model_stiffness(s->model);
    double u[3 * STRESS_NODES], v[3 * STRESS_NODES], last = INFINITY, speed = 0, *work = NULL;
    sfem_ldl *ldl = NULL;
    int turn, found = 0;
    size_t i;
    *far = 0;
    memcpy(u, sfem_body_displacement(s->body), n * sizeof *u);
    sfem_body_velocities(s->body, v);
    for (i = 0; i < n; ++i) speed = fmax(speed, fabs(v[i]));
    k.val = (double *)malloc(9 * (size_t)k.row[k.n] * sizeof *k.val);
    for (turn = 0; turn < 30 && !found && speed * s->period < STRESS_SHAPE_TOLERANCE * s->size;
         ++turn) {
        (void)sfem_model_forces(s->model, u, SFEM_DOUBLE, s->f, NULL, NULL, s->work, NULL);
        for (i = 0; s->held && i < 3 * (size_t)s->pin_count; ++i)
            s->f[3 * s->pins[i / 3] + (sfem_int)(i % 3)] = 0;
        if (stress_pivots(s, u, shift, &k, &ldl)) break;
        if (!work) work = (double *)malloc(sfem_ldl_work_size(ldl, 1) * sizeof *work);
        sfem_ldl_solve(ldl, 1, s->f, work, NULL);
        for (last = 0, i = 0; i < n; ++i) {
            u[i] -= s->f[i];
            last = fmax(last, fabs(s->f[i]));
            *far = fmax(*far, fabs(u[i] - sfem_body_displacement(s->body)[i]));
        }
        if (!(*far <= STRESS_SHAPE_TOLERANCE * s->size)) break;
        found = last < 1e-9 * s->size;
    }
    sfem_ldl_free(ldl);
    free(k.val);
    free(work);
    return found;
}

/* Damped, until it is back or time is up. Returns the shape. */
STRESS_STATIC double stress_settle(stress_body *s, double h, int steps, stress_result *r)
{
    double shape = INFINITY, last;
    sfem_error err;
    int k;
    for (k = 0; k < steps && sfem_body_get_info(s->body).solves < STRESS_DESCENTS; ++k) {
        if (sfem_body_step(s->body, h, &err)) {
            stress_failed(r, &err);
            return INFINITY;
        }
        ++r->damped_steps;
        if (k % 50 != 49) continue;
        last = shape;
        shape = stress_misshape(s);
        if (!isfinite(shape)) stress_note(r, STRESS_IS_NOT_FINITE, "shape");
        if (!isfinite(shape) || (shape < 0.5 * STRESS_SHAPE_TOLERANCE && shape <= last)) break;
    }
    return stress_misshape(s);
}

STRESS_STATIC void stress_come_back(stress_body *s, stress_form form, double h, stress_result *r)
{
    const double own = stress_is_newton(form) || form >= STRESS_FORM_CENTRAL ? 0 : h;
    double step = fmax(own, s->period / 40), u[3 * STRESS_NODES], v[3 * STRESS_NODES], far = 0;
    sfem_body_def def;
    sfem_error err;
    sfem_int inverted = 0;
    char why[160];
    int in_minimum = 0, round;
    memcpy(u, sfem_body_displacement(s->body), 3 * (size_t)s->mesh.nodes * sizeof(double));
    sfem_body_velocities(s->body, v);
    sfem_body_free(s->body);
    s->body = NULL;
    s->gravity = 0;
    if (form >= STRESS_FORM_CENTRAL) form = STRESS_FORM_DEFAULT, step = s->period / 40;
    def = stress_def(s, form, h);
    def.mass_damping = fmin(1 / s->period, 0.5 / step);
    def.stiffness_damping = fmax(step, s->period / 10);
    if (sfem_body_create(s->model, &def, &s->body, &err) ||
        sfem_body_set_state(s->body, u, v, &err)) {
        stress_failed(r, &err);
        return;
    }
    for (round = 0; round < 4 && !in_minimum; ++round) { /* strongly distorted bars take their time */
        r->shape = stress_settle(s, step, stress_is_newton(form) ? 400 : 3000, r);
        if (r->shape < STRESS_SHAPE_TOLERANCE || r->verdict != STRESS_IS_PASSED) return;
        in_minimum = s->scene->law != SFEM_LINEAR && stress_has_minimum(s, &far);
    }
    (void)sfem_model_forces(s->model, sfem_body_displacement(s->body), SFEM_DOUBLE, s->f, NULL,
                            &inverted, s->work, NULL);
    r->inverted = (int)inverted;
    snprintf(why, sizeof why,
             "off by %.3g of its length after %d damped steps, %d tets inverted; %s %.1g m away",
             r->shape, r->damped_steps, (int)inverted,
             in_minimum ? "a minimum" : "no minimum seen up to", far);
    stress_note(r, in_minimum ? STRESS_IS_MINIMUM : STRESS_IS_SHAPE, why);
}

/* ---- six seconds ---- */

enum { STRESS_HANDS = 2, STRESS_PINS = 8 };

typedef struct stress_hold {
    sfem_int handle[STRESS_HANDS], pin[STRESS_PINS];
    int hands, pins;
} stress_hold;

/* Other pins, none of a fifth of the time, and other handles, all where the nodes are: they do no work. */
STRESS_STATIC sfem_status stress_exchange(stress_body *s, stress_hold *d, uint64_t *random,
                                          sfem_error *err)
{
    const int pins = stress_below(random, 5) ? 1 + stress_below(random, STRESS_PINS) : 0;
    const int hands = stress_below(random, STRESS_HANDS + 1);
    sfem_status status;
    int k, i;
    for (k = 0; k < d->hands; ++k) sfem_body_release_handle(s->body, d->handle[k]);
    for (k = 0, d->pins = 0; k < pins; ++k) {
        const sfem_int node = stress_below(random, (int)s->mesh.nodes);
        for (i = 0; i < d->pins && d->pin[i] != node; ++i) continue;
        if (i == d->pins) d->pin[d->pins++] = node;
    }
    status = sfem_body_set_pins(s->body, d->pins, d->pin, NULL, err);
    for (k = 0, d->hands = 0; k < hands && !status; ++k) {
        const sfem_int node = stress_below(random, (int)s->mesh.nodes);
        for (i = 0; i < d->pins && d->pin[i] != node; ++i) continue;
        if (i < d->pins) continue;
        status = sfem_body_grab_node(s->body, node, &d->handle[d->hands], err);
        d->hands += !status;
    }
    return status;
}

typedef struct stress_push {
    double force[3 * STRESS_NODES];   /* that pushes, for half a second; balanced on a free body */
    double impulse[3 * STRESS_NODES]; /* N s, of this step */
    double way[3 * STRESS_NODES];     /* of the step before */
    int runs; /* the last step was neither the first nor rejected */
} stress_push;

STRESS_STATIC void stress_choose_force(const stress_body *s, double *force, uint64_t *random)
{
    const double *mass = sfem_model_node_mass(s->model);
    const double size = fmin(1e-4 * s->scene->young, 50 * s->mass);
    double sum[3] = {0, 0, 0};
    sfem_int i;
    int k, c;
    memset(force, 0, 3 * STRESS_NODES * sizeof *force);
    for (k = 0; k < 3; ++k) {
        const int node = stress_below(random, (int)s->mesh.nodes);
        for (c = 0; c < 3; ++c) {
            force[3 * node + c] = size * stress_normal(random);
            sum[c] += force[3 * node + c];
        }
    }
    for (i = 0; !s->held && i < 3 * s->mesh.nodes; ++i)
        force[i] -= mass[i / 3] / s->mass * sum[i % 3];
}

/* Some nodes are pushed for half a second, each with some 1e-4 m^2 E, which bends a held bar by a sixteenth of its
 * length, but no more than moves the whole by 50 m/s^2; now and then one gets 5 m/s at once. */
STRESS_STATIC void stress_choose_push(const stress_body *s, stress_push *q, int another,
                                      uint64_t *random)
{
    int k, c;
    memset(q->impulse, 0, sizeof q->impulse);
    if (another) stress_choose_force(s, q->force, random);
    if (stress_below(random, 20) == 0) {
        const int node = stress_below(random, (int)s->mesh.nodes);
        for (c = 0; c < 3; ++c)
            q->impulse[3 * node + c] =
                5 * sfem_model_node_mass(s->model)[node] * stress_normal(random);
    }
    for (k = 0; s->held && k < s->pin_count; ++k)
        for (c = 0; c < 3; ++c) q->force[3 * s->pins[k] + c] = q->impulse[3 * s->pins[k] + c] = 0;
}

/* A step in three parts, with those forces and impulses. M (w' - w) = h F + I: h F/2 in a step from a start, h F/2 more
 * in a rejected one, whose w' is the velocity at its end, from which the next one starts. The mean kinetic energy grows
 * by F.(d' + d)/2, d = h w, and up to the end of the step by F.d'/2 more. This work, less that on the centre of mass of a
 * free body, and the momentum go where the energy and the momentum at the start are. */
STRESS_STATIC sfem_status stress_pushed_step(stress_body *s, stress_push *q, double h, stress_watch *w,
                                             sfem_error *err)
{
    const double *mass = sfem_model_node_mass(s->model);
    const size_t n = 3 * (size_t)s->mesh.nodes;
    const int64_t before = sfem_body_get_info(s->body).rejected;
    double sum[3] = {0, 0, 0}, centre[3] = {0, 0, 0}, work = 0, ahead = 0, part;
    size_t i;
    sfem_status status = sfem_body_predict(s->body, h, err);
    for (i = 0; i < n && !status; ++i) sfem_body_rhs(s->body)[i] += q->force[i];
    for (i = 0; i < n / 3 && !status; ++i)
        status = sfem_body_add_impulse(s->body, (sfem_int)i, q->impulse + 3 * i, err);
    if (!status) status = sfem_body_solve(s->body, err);
    if (!status) status = sfem_body_finish(s->body, err);
    part = (q->runs ? 1 : 0.5) + (sfem_body_get_info(s->body).rejected > before ? 0.5 : 0);
    q->runs = sfem_body_get_info(s->body).rejected == before;
    for (i = 0; i < n && !status; ++i) {
        const double f = part * q->force[i] + q->impulse[i] / h;
        const double d = sfem_body_displacement(s->body)[i] - s->before[i];
        work += f * (d + q->way[i]) / 2;
        ahead += q->force[i] * d / 2; /* which is balanced */
        sum[i % 3] += f;
        centre[i % 3] += mass[i / 3] * (d + q->way[i]) / (2 * s->mass);
        q->way[i] = d;
    }
    for (i = 0; i < 3; ++i) {
        if (!s->held) work -= sum[i] * centre[i];
        w->p0[i] += h * sum[i];
    }
    w->start += work;
    w->ahead = ahead;
    w->largest += fabs(work);
    return status;
}

/* 6 s. What is not calm may reject as it likes. */
STRESS_STATIC void stress_six_seconds(stress_body *s, stress_form form, uint64_t *random,
                                      stress_result *r)
{
    const stress_scene *scene = s->scene;
    const double half = 0.5;
    stress_watch w;
    stress_hold hold;
    stress_push push;
    sfem_error err;
    double t = 0;
    int k, change = 0;
    memset(&hold, 0, sizeof hold);
    memset(&push, 0, sizeof push);
    stress_begin(s, &w, scene->h);
    for (k = 0; k < 3 * s->mesh.nodes; ++k) push.way[k] = scene->h * s->v0[k];
    for (k = 0; k < scene->steps && sfem_body_get_info(s->body).solves < STRESS_DESCENTS; ++k) {
        const int another = t >= half * change;
        sfem_status status = SFEM_OK;
        double h = scene->h;
        change += another;
        if (scene->family == STRESS_UNEVEN) h *= pow(10, stress_uniform(random, -0.5, 0.5));
        if (scene->family == STRESS_SWAP && another && k)
            status = stress_exchange(s, &hold, random, &err);
        if (s->broken) status = stress_damage(s, k, random, &err);
        if (status == SFEM_BAD_ARGUMENT && s->broken) status = SFEM_OK; /* no such edge */
        memcpy(s->before, sfem_body_displacement(s->body),
               3 * (size_t)s->mesh.nodes * sizeof(double));
        if (scene->family == STRESS_PUSH) {
            stress_choose_push(s, &push, another, random);
            if (!status) status = stress_pushed_step(s, &push, h, &w, &err);
        } else if (!status) {
            status = sfem_body_step(s->body, h, &err);
        }
        if (status) {
            stress_failed(r, &err);
            break;
        }
        t += h;
        r->steps = k + 1;
        if (!stress_check(s, form, &w, h, r)) break;
    }
    r->rejected = r->steps ? (double)sfem_body_get_info(s->body).rejected / r->steps : 0;
    r->moved = w.moved / s->size;
    if (scene->family <= STRESS_ROLL && !(r->rejected <= STRESS_REJECTED_TOLERANCE)) {
        char why[96];
        snprintf(why, sizeof why, "%.3g of the steps rejected", r->rejected);
        stress_note(r, STRESS_IS_LOSSY, why);
    }
    stress_ask_motion(s, form, &w, r);
    if (scene->family == STRESS_SWAP) s->held = 0; /* it may lie anywhere: let go */
}

STRESS_STATIC void stress_run_body(const stress_scene *scene, stress_form form, stress_result *r)
{
    uint64_t random = scene->seed * 0x9e3779b97f4a7c15u + 12345;
    double h = scene->h;
    sfem_body_def def;
    stress_body s;
    sfem_error err;
    sfem_status status = stress_build(scene, form, &random, &s, &err);
    if (!status) {
        def = stress_def(&s, form, h);
        def.gravity[1] = -s.gravity;
        status = sfem_body_create(s.model, &def, &s.body, &err);
    }
    if (!status && form == STRESS_FORM_CENTRAL) {
        status = sfem_body_prepare(s.body, 1e-12, &err);
        if (sfem_body_get_info(s.body).stable_step > 0)
            h = fmin(h, 0.5 * sfem_body_get_info(s.body).stable_step);
    }
    if (!status) {
        stress_state(&s, &random);
        status = sfem_body_set_state(s.body, s.u0, s.v0, &err);
    }
    if (status)
        stress_failed(r, &err);
    else if (scene->family >= STRESS_FALL)
        stress_six_seconds(&s, form, &random, r);
    else
        stress_violence(&s, form, h, &random, r);
    if (!status && r->verdict == STRESS_IS_PASSED && !s.broken) stress_come_back(&s, form, h, r);
    stress_free(&s);
}

/* ---- modal bodies ---- */

enum { STRESS_MODES = 16 };

typedef struct stress_modal {
    stress_body full;
    sfem_reduced *reduced[2]; /* undamped, damped by a tenth in the lowest mode */
    sfem_modal *body[2];
    double lowest; /* omega */
} stress_modal;

STRESS_STATIC void stress_modal_free(stress_modal *m)
{
    int k;
    for (k = 0; k < 2; ++k) {
        sfem_modal_free(m->body[k]);
        sfem_reduced_free(m->reduced[k]);
    }
    stress_free(&m->full);
}

STRESS_STATIC sfem_status stress_modal_build(const stress_scene *scene, stress_form form,
                                             uint64_t *random, stress_modal *m, sfem_error *err)
{
    sfem_modes_def modes_def = sfem_default_modes_def();
    sfem_modal_def def = sfem_default_modal_def();
    sfem_modes modes;
    sfem_status status;
    int k;
    memset(m, 0, sizeof *m);
    status = stress_build(scene, form, random, &m->full, err);
    if (status) return status;
    m->full.held = 1;
    modes_def.modes = STRESS_MODES;
    modes_def.pins = m->full.pins;
    modes_def.pin_count = m->full.pin_count;
    status = sfem_modes_create(m->full.model, &modes_def, &modes, err);
    if (status) return status;
    m->lowest = sqrt(modes.lambda[0]);
    if (form == STRESS_FORM_EXACT) def.integrator = SFEM_MODAL_EXACT;
    if (form == STRESS_FORM_NAIVE) {
        def.handle_beta = 0.25;
        def.handle_gamma = 0.5;
        def.compliance = 0;
    }
    def.max_handles = 24;
    def.max_handle_nodes = 64;
    for (k = 0; k < 2 && !status; ++k) {
        sfem_reduced_def reduced = sfem_default_reduced_def();
        if (k) reduced.mass_damping = 0.2 * m->lowest, reduced.stiffness_damping = 0.1 / m->lowest;
        status = sfem_reduced_create(m->full.model, &modes, &reduced, &m->reduced[k], err);
        if (!status) status = sfem_modal_create(m->reduced[k], &def, &m->body[k], err);
    }
    sfem_modes_free(&modes);
    return status;
}

/* Root mean square over the mass of the displacement Phi q, m. */
STRESS_STATIC double stress_modal_mean(const stress_modal *m, const double *q)
{
    double sum = 0;
    int k;
    for (k = 0; k < STRESS_MODES; ++k) sum += q[k] * q[k];
    return sqrt(sum / m->full.mass);
}

/* Seven neighbours at the end and some of them twice, or any nodes; targets follow a smooth path, up to a tenth of
 * the bar's length, each off by a hundredth of that at random, anew at each step. */
typedef struct stress_hands {
    sfem_int handle[16], node[16];
    int count;
    double phase[3], to[16][3];
    double phi[16][3][STRESS_MODES], psi[16][3][STRESS_MODES];
    double give,
        rest[STRESS_MODES]; /* C, see stress_hands_rest; where they would have it at rest */
} stress_hands;

/* C = 1e-4 of the mean of diag J Lambda^-1 J^T at rest, over axes that move. */
STRESS_STATIC void stress_hands_measure(const stress_modal *m, stress_hands *g)
{
    const sfem_real *lambda = sfem_reduced_get_info(m->reduced[0]).lambda;
    double of[48], most = 0, sum = 0;
    int k, c, j, count = 0;
    for (k = 0; k < g->count; ++k) {
        sfem_reduced_node_modes(m->reduced[0], g->node[k], &g->phi[k][0][0], &g->psi[k][0][0]);
        for (c = 0; c < 3; ++c) {
            of[3 * k + c] = 0;
            for (j = 0; j < STRESS_MODES; ++j)
                of[3 * k + c] += g->phi[k][c][j] * g->phi[k][c][j] / lambda[j];
            most = fmax(most, of[3 * k + c]);
        }
    }
    for (k = 0; k < 3 * g->count; ++k)
        if (of[k] > 1e-12 * most) sum += of[k], ++count;
    g->give = count ? 1e-4 * sum / count : 1;
    memset(g->rest, 0, sizeof g->rest);
}

/* gaps = x - target of warped nodes; returns q.Lambda q + sum gap^2/C. */
STRESS_STATIC double stress_hands_energy(const stress_modal *m, const stress_hands *g,
                                         const double *q, double *gap)
{
    const sfem_real *lambda = sfem_reduced_get_info(m->reduced[0]).lambda;
    double sum = 0;
    int k, c, j;
    for (j = 0; j < STRESS_MODES; ++j) sum += lambda[j] * q[j] * q[j];
    for (k = 0; k < g->count; ++k) {
        double u[3] = {0, 0, 0}, w[3] = {0, 0, 0}, wu[3], wwu[3], t, a, b;
        for (c = 0; c < 3; ++c)
            for (j = 0; j < STRESS_MODES; ++j)
                u[c] += g->phi[k][c][j] * q[j], w[c] += g->psi[k][c][j] * q[j];
        t = sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2]);
        a = t < 1e-3 ? 0.5 - t * t / 24 : (1 - cos(t)) / (t * t);
        b = t < 1e-3 ? 1.0 / 6 - t * t / 120 : (1 - sin(t) / t) / (t * t);
        stress_cross(w, u, wu);
        stress_cross(w, wu, wwu);
        for (c = 0; c < 3; ++c) {
            const double d =
                u[c] + a * wu[c] + b * wwu[c] + m->full.mesh.x[3 * g->node[k] + c] - g->to[k][c];
            gap[3 * k + c] = d;
            sum += d * d / g->give;
        }
    }
    return sum;
}

/* x = A^-1 x, symmetric and positive, by Cholesky. */
STRESS_STATIC void stress_solve(double a[STRESS_MODES][STRESS_MODES], double *x)
{
    int i, j, k;
    for (j = 0; j < STRESS_MODES; ++j)
        for (i = j; i < STRESS_MODES; ++i) {
            double sum = a[i][j];
            for (k = 0; k < j; ++k) sum -= a[i][k] * a[j][k];
            a[i][j] = i == j ? sqrt(fmax(sum, 1e-300)) : sum / a[j][j];
        }
    for (i = 0; i < STRESS_MODES; ++i) {
        for (k = 0; k < i; ++k) x[i] -= a[i][k] * x[k];
        x[i] /= a[i][i];
    }
    for (i = STRESS_MODES - 1; i >= 0; --i) {
        for (k = i + 1; k < STRESS_MODES; ++k) x[i] -= a[k][i] * x[k];
        x[i] /= a[i][i];
    }
}

/* One step of Levenberg and Marquardt's towards that energy's least, J by differences. */
STRESS_STATIC int stress_hands_descend(const stress_modal *m, stress_hands *g, double *damping)
{
    const sfem_real *lambda = sfem_reduced_get_info(m->reduced[0]).lambda;
    double gap[48], two[2][48], jacobian[48][STRESS_MODES], a[STRESS_MODES][STRESS_MODES];
    double x[STRESS_MODES], q[STRESS_MODES];
    const double energy = stress_hands_energy(m, g, g->rest, gap);
    int i, j, k, tries;
    for (j = 0; j < STRESS_MODES; ++j) {
        const double d = 1e-6 * (0.01 + fabs(g->rest[j]));
        for (k = 0; k < 2; ++k) {
            memcpy(q, g->rest, sizeof q);
            q[j] += k ? d : -d;
            stress_hands_energy(m, g, q, two[k]);
        }
        for (i = 0; i < 3 * g->count; ++i) jacobian[i][j] = (two[1][i] - two[0][i]) / (2 * d);
    }
    for (tries = 0; tries < 12; ++tries, *damping = *damping * 10 + 1e-8) {
        double now;
        for (j = 0; j < STRESS_MODES; ++j) {
            x[j] = -lambda[j] * g->rest[j];
            for (i = 0; i < 3 * g->count; ++i) x[j] -= jacobian[i][j] * gap[i] / g->give;
            for (k = 0; k < STRESS_MODES; ++k) {
                a[j][k] = j == k ? lambda[j] : 0;
                for (i = 0; i < 3 * g->count; ++i)
                    a[j][k] += jacobian[i][j] * jacobian[i][k] / g->give;
            }
            a[j][j] *= 1 + *damping;
        }
        stress_solve(a, x);
        for (j = 0; j < STRESS_MODES; ++j) q[j] = g->rest[j] + x[j];
        now = stress_hands_energy(m, g, q, two[0]);
        if (!(now < energy)) continue;
        memcpy(g->rest, q, sizeof q);
        *damping *= 0.1;
        return energy - now > 1e-10 * energy;
    }
    return 0;
}

/* Where the present targets would have the body at rest, sought from where the last ones had it: the least of
 * q.Lambda q/2 + sum |x - target|^2/2C, found here by another way than the library's. */
STRESS_STATIC void stress_hands_rest(const stress_modal *m, stress_hands *g)
{
    double damping = 1e-8;
    int k;
    for (k = 0; k < 60 && stress_hands_descend(m, g, &damping); ++k) continue;
}

STRESS_STATIC sfem_status stress_modal_grab(stress_modal *m, stress_hands *g, uint64_t *random,
                                            sfem_error *err)
{
    const sfem_int nodes = m->full.mesh.nodes;
    const int kind = stress_below(random, 3);
    sfem_status status = SFEM_OK;
    int k;
    g->count = kind == 0 ? 7 : kind == 1 ? 12 : 1 + stress_below(random, 6);
    for (k = 0; k < g->count && !status; ++k) {
        g->node[k] = kind == 0 ? nodes - 1 - k /* noisy neighbours */
                     : kind == 1
                         ? nodes - 1 - k % 9                           /* some twice */
                         : (sfem_int)stress_below(random, (int)nodes); /* pinned ones, too */
        status = sfem_modal_grab_node(m->body[0], g->node[k], &g->handle[k], err);
        if (status) g->count = k;
    }
    for (k = 0; k < 3; ++k) g->phase[k] = stress_uniform(random, 0, 6.28);
    stress_hands_measure(m, g);
    return status;
}

STRESS_STATIC sfem_status stress_modal_move(stress_modal *m, stress_hands *g, double time,
                                            uint64_t *random, sfem_error *err)
{
    const double size = 0.1 * m->full.size;
    sfem_status status = SFEM_OK;
    int k, c;
    for (k = 0; k < g->count && !status; ++k) {
        const double *x = m->full.mesh.x + 3 * g->node[k];
        double *to = g->to[k];
        for (c = 0; c < 3; ++c)
            to[c] = x[c] + size * (sin(0.3 * m->lowest * time + g->phase[c]) / 1.733 +
                                   0.01 * stress_normal(random));
        status = sfem_modal_move_handle(m->body[0], g->handle[k], to, err);
    }
    return status;
}

STRESS_STATIC void stress_modal_release(stress_modal *m, stress_hands *g)
{
    int k;
    for (k = 0; k < g->count; ++k) sfem_modal_release_handle(m->body[0], g->handle[k]);
    g->count = 0;
}

/* Left alone, the undamped body keeps its energy to rounding; the damped one comes to rest. One held by its pinned
 * nodes alone has not moved: that is plucked. */
STRESS_STATIC void stress_modal_settle(stress_modal *m, double h, int steps, stress_result *r)
{
    const sfem_modal *b = m->body[0];
    double first, now, sum = 0, whole = 0, zero[STRESS_MODES] = {0}, pluck[STRESS_MODES];
    sfem_error err;
    int k;
    memset(&err, 0, sizeof err);
    for (k = 0; k < STRESS_MODES; ++k) {
        whole +=
            pow(sfem_modal_coordinates(b)[k], 2) + pow(sfem_modal_coordinate_velocities(b)[k] / m->lowest, 2);
        pluck[k] = 0.1 / (1 + k);
    }
    if (whole == 0) sfem_modal_set_coordinates(m->body[0], pluck, zero, NULL, &err);
    whole = 0;
    if (sfem_modal_set_coordinates(m->body[1], sfem_modal_coordinates(b), sfem_modal_coordinate_velocities(b),
                                   NULL, &err))
        stress_failed(r, &err);
    for (k = 0; k < STRESS_MODES; ++k) whole += pow(sfem_modal_coordinates(b)[k], 2);
    sfem_modal_step(m->body[0], h,
                    &err); /* Newmark keeps it once no hand is in its accelerations */
    first = sfem_modal_get_info(b).kinetic + sfem_modal_get_info(b).elastic;
    for (k = 0; k < steps; ++k) {
        if (sfem_modal_step(m->body[0], h, &err)) {
            stress_failed(r, &err);
            return;
        }
        now = sfem_modal_get_info(b).kinetic + sfem_modal_get_info(b).elastic;
        r->excess = fmax(r->excess, fabs(now - first) / first);
    }
    if (!(r->excess < 1e-8)) {
        snprintf(r->why, sizeof r->why, "undamped and free, energy off by %.2g", r->excess);
        if (r->verdict == STRESS_IS_PASSED) r->verdict = STRESS_IS_ENERGY;
    }
    for (k = 0; k < 400; ++k)
        if (sfem_modal_step(m->body[1], fmax(h, 0.2 / m->lowest), &err)) {
            stress_failed(r, &err);
            return;
        }
    for (k = 0; k < STRESS_MODES; ++k) sum += pow(sfem_modal_coordinates(m->body[1])[k], 2);
    r->shape = sqrt(sum / whole);
    if (!(r->shape < STRESS_SHAPE_TOLERANCE))
        stress_note(r, STRESS_IS_SHAPE, "damped modes remain");
}

/* While held, a body is no further from its place, in the mean over its mass, than 2/(1 - .3^2) times the farthest
 * that the targets so far would have it at rest. Body and hands are oscillators: in each of their normal coordinates
 * the answer to targets that set out at once is at most twice where these end, and where they go on as a sine of .3
 * of the lowest frequency, 1/(1 - .3^2) times that; the coordinates are orthogonal in the mass. Targets that
 * contradict one another, or move nodes beside the pins, legitimately throw others far: that rest knows how far. */
STRESS_STATIC void stress_run_modal(const stress_scene *scene, stress_form form, stress_result *r)
{
    uint64_t random = scene->seed * 0x9e3779b97f4a7c15u + 777;
    double allowed = 0;
    stress_modal m;
    stress_hands hands;
    sfem_error err;
    sfem_status status = stress_modal_build(scene, form, &random, &m, &err);
    double most = 0;
    int k, held = 0;
    memset(&hands, 0, sizeof hands);
    for (k = 0; k < scene->steps && !status; ++k) {
        if (!hands.count && (k == 0 || stress_below(&random, 100) == 0)) {
            /* a body that still swings is caught where it is: first quieted */
            double zero[STRESS_MODES] = {0};
            sfem_modal_set_coordinates(m.body[0], zero, zero, NULL, NULL);
            status = stress_modal_grab(&m, &hands, &random, &err);
            held = k;
            allowed = 0;
        }
        if (!status && hands.count)
            status = stress_modal_move(&m, &hands, (k - held) * scene->h, &random, &err);
        if (!status) status = sfem_modal_step(m.body[0], scene->h, &err);
        if (status) break;
        r->steps = k + 1;
        if (hands.count && (k - held < 5 || k % 5 == 0)) {
            const double far = stress_modal_mean(&m, sfem_modal_coordinates(m.body[0]));
            stress_hands_rest(&m, &hands);
            allowed = fmax(allowed, 2 / (1 - 0.09) * stress_modal_mean(&m, hands.rest));
            if (!(far <= most)) most = far;
            if (!(far <= allowed) && r->verdict == STRESS_IS_PASSED) {
                r->verdict = isfinite(far) ? STRESS_IS_WRONG : STRESS_IS_NOT_FINITE;
                snprintf(r->why, sizeof r->why,
                         "%d handles: %.3g m away, %.3g is in order (step %d)", hands.count, far,
                         allowed, k);
            }
        }
        if (hands.count && k - held > 50 && stress_below(&random, 200) == 0)
            stress_modal_release(&m, &hands);
    }
    if (status) stress_failed(r, &err);
    if (!status && most < 0.005) stress_note(r, STRESS_IS_STILL, ""); /* the tip by a hundredth */
    if (!status) {
        stress_modal_release(&m, &hands);
        stress_modal_settle(&m, scene->h, scene->steps / 4, r);
    }
    stress_modal_free(&m);
}

/* ---- streams ---- */

typedef struct stress_packet {
    unsigned char byte[64 + 24 * STRESS_MODES];
    size_t bytes;
    int due; /* step at which it arrives */
} stress_packet;

enum { STRESS_UNDERWAY = 64 };

/* The sender's body is pushed, caught and let go; a tenth to a half of the packets are lost, others come
 * twice, late, or damaged. The receiver stays finite; within thrice the swing that the sender made, since
 * key frames come once in 30 steps; and where the link has been whole for two of them, it has what the sender has.
 * The link of the last 100 steps is whole. */
STRESS_STATIC void stress_run_stream(const stress_scene *scene, stress_form form, stress_result *r)
{
    uint64_t random = scene->seed * 0x9e3779b97f4a7c15u + 99;
    const double loss = stress_uniform(&random, 0.1, 0.5);
    static const sfem_lost lost[3] = {SFEM_LOST_ZERO, SFEM_LOST_HELD, SFEM_LOST_EXTRAPOLATED};
    stress_packet underway[STRESS_UNDERWAY];
    sfem_link_def link = sfem_default_link_def();
    sfem_sender *sender = NULL;
    sfem_receiver *receiver = NULL;
    stress_modal m;
    stress_hands hands;
    sfem_error err;
    sfem_status status = stress_modal_build(scene, form, &random, &m, &err);
    double swing = 0, off = 0, last = 0, *force;
    int k, i, held = 0;
    force = (double *)calloc(3 * STRESS_NODES, sizeof *force);
    memset(&hands, 0, sizeof hands);
    memset(underway, 0, sizeof underway);
    link.modes = STRESS_MODES;
    link.h = scene->h;
    link.stream = 7;
    link.first = (uint32_t)(0xffffffffu - 500); /* it wraps */
    link.lost = lost[stress_below(&random, 3)];
    if (!status) status = sfem_sender_create(&link, &sender, &err);
    if (!status) status = sfem_receiver_create(&link, &receiver, &err);
    for (k = 0; k < scene->steps && !status; ++k) {
        const int whole = k > scene->steps - 100;
        const int began = receiver && sfem_receiver_get_info(receiver).started;
        stress_packet p;
        if (k % 40 == 0) { /* a push that a metre of the bar's bending stiffness would give */
            const double push = 0.03 * scene->young * 0.01 * stress_normal(&random);
            force[3 * (m.full.mesh.nodes - 1) + (k / 40) % 3] = push;
            status = sfem_modal_set_lasting_force(m.body[0], force, &err);
        }
        if (!hands.count && stress_below(&random, 150) == 0 && !whole) {
            status = stress_modal_grab(&m, &hands, &random, &err);
            sfem_sender_set_held(sender, 1);
            held = k;
        } else if (hands.count && (whole || stress_below(&random, 60) == 0)) {
            stress_modal_release(&m, &hands);
            sfem_sender_set_held(sender, 0);
        }
        if (!status && hands.count)
            status = stress_modal_move(&m, &hands, (k - held) * scene->h, &random, &err);
        if (k == 0) sfem_modal_start(m.body[0]);
        if (!status && k > 0) status = sfem_modal_step(m.body[0], scene->h, &err);
        if (!status)
            status = sfem_sender_write(
                sender, sfem_modal_coordinates(m.body[0]), sfem_modal_coordinate_velocities(m.body[0]),
                sfem_modal_coordinate_accelerations(m.body[0]), p.byte, sizeof p.byte, &p.bytes, &err);
        if (status) break;
        r->steps = k + 1;
        for (i = 0; i < 2; ++i) { /* once, and perhaps again */
            stress_packet *to = &underway[stress_below(&random, STRESS_UNDERWAY)];
            const double what = stress_uniform(&random, 0, 1);
            if (whole && i == 0) {
                sfem_receiver_read(receiver, p.byte, p.bytes);
                continue;
            }
            if (what < loss || to->bytes || (i && what < 0.8)) continue;
            *to = p;
            to->due = k + (what > 0.9 ? stress_below(&random, 20) : 0);
            if (stress_below(&random, 10) == 0)
                to->byte[stress_below(&random, (int)p.bytes)] ^=
                    (unsigned char)(1 + stress_below(&random, 255));
        }
        for (i = 0; i < STRESS_UNDERWAY; ++i) {
            if (!underway[i].bytes || underway[i].due > k) continue;
            sfem_receiver_read(receiver, underway[i].byte, underway[i].bytes);
            underway[i].bytes = 0;
        }
        if (began) sfem_receiver_step(receiver);
        while (sfem_receiver_lead(receiver) > 0)
            sfem_receiver_step(receiver); /* it began at a late one */
        last = 0;
        for (i = 0; i < STRESS_MODES; ++i) {
            const double q = sfem_modal_coordinates(m.body[0])[i];
            const double d = fabs(sfem_receiver_coordinates(receiver)[i] - q);
            swing = fmax(swing, fabs(q));
            if (!(d <= last)) last = d;
        }
        if (!(last <= off)) off = last;
    }
    if (status) stress_failed(r, &err);
    if (!status && swing > 0) r->excess = off / swing, r->shape = last / swing;
    if (!isfinite(off)) stress_note(r, STRESS_IS_NOT_FINITE, "receiver");
    if (!status && !(r->shape < 1e-9)) {
        snprintf(r->why, sizeof r->why, "off by %.2g of the swing, at last %.2g", r->excess,
                 r->shape);
        if (r->verdict == STRESS_IS_PASSED) r->verdict = STRESS_IS_WRONG;
    }
    if (!status && !(swing > 0)) stress_note(r, STRESS_IS_STILL, "");
    free(force);
    sfem_receiver_free(receiver);
    sfem_sender_free(sender);
    stress_modal_free(&m);
}

/* ---- eigenproblems ---- */

/* One to three bars, each with its slivers or stretched to a needle or a plate, somewhere in space, in one mesh. */
STRESS_STATIC void stress_odd_mesh(const stress_body *s, uint64_t *random, sfem_mesh *out)
{
    const int copies = 1 + stress_below(random, 3), shape = stress_below(random, 3);
    int j, c;
    sfem_int i;
    memset(out, 0, sizeof *out);
    out->x = (sfem_real *)malloc((size_t)(3 * copies * STRESS_NODES) * sizeof(sfem_real));
    out->tet = (sfem_int *)malloc((size_t)(16 * copies * STRESS_NODES) * sizeof(sfem_int));
    for (j = 0; j < copies; ++j) {
        double scale[3] = {1, 1, 1};
        if (shape == 1) scale[0] = pow(10, stress_uniform(random, 0, 2));
        if (shape == 2) scale[2] = pow(10, -stress_uniform(random, 0, 3));
        for (i = 0; i < 3 * s->mesh.nodes; ++i) {
            c = (int)(i % 3);
            out->x[3 * out->nodes + i] = scale[c] * s->mesh.x[i] + (c == 1 ? 2.0 * j : 0);
        }
        for (i = 0; i < 4 * s->mesh.tets; ++i)
            out->tet[4 * out->tets + i] = s->mesh.tet[i] + out->nodes;
        out->nodes += s->mesh.nodes;
        out->tets += s->mesh.tets;
    }
}

/* Lanczos against the dense solver; backward errors; phi.M phi = 1; the number of rigid modes. */
STRESS_STATIC void stress_compare_modes(sfem_model *model, const sfem_modes *a, const sfem_modes *b,
                                        stress_result *r)
{
    const size_t n = 3 * (size_t)a->nodes;
    const sfem_matrix *stiffness = sfem_model_stiffness(model);
    double *y = (double *)malloc(n * sizeof *y), scale = b->lambda[b->count - 1], largest = 0;
    double value = 0, norm = 0, backward = 0;
    int i, j;
    size_t k;
    if (a->rigid != b->rigid || a->count != b->count) {
        stress_note(r, STRESS_IS_WRONG, "another number of rigid modes than the dense solver");
        free(y);
        return;
    }
    for (i = 0; i < a->nodes;
         ++i) /* what the dense solver loses is 1e-15 of the largest eigenvalue, or so */
        for (j = 0; j < 9; j += 4)
            largest = fmax(largest, stiffness->val[9 * (stiffness->row[i + 1] - 1) + j] /
                                        sfem_model_node_mass(model)[i]);
    for (i = 0; i < a->count; ++i) {
        value = fmax(value, fmax(fabs(a->lambda[i] - b->lambda[i]) - 1e-13 * largest, 0) /
                                (fabs(b->lambda[i]) + 1e-6 * scale));
        backward = fmax(backward, a->error[i]);
        sfem_model_multiply_mass(model, a->phi + n * (size_t)i, y, NULL);
        for (j = 0; j <= i; ++j) {
            double dot = i == j ? -1 : 0;
            for (k = 0; k < n; ++k) dot += y[k] * a->phi[n * (size_t)j + k];
            norm = fmax(norm, fabs(dot));
        }
    }
    free(y);
    r->excess = value;
    r->shape = norm;
    r->linear = backward;
    if (!(value < 1e-6 && norm < 1e-8 && backward < 1e-10)) {
        char why[120];
        snprintf(why, sizeof why,
                 "eigenvalues off by %.2g, orthonormal to %.2g, backward error %.2g", value, norm,
                 backward);
        stress_note(r, STRESS_IS_WRONG, why);
    }
}

STRESS_STATIC void stress_run_eigen(const stress_scene *scene, stress_form form, stress_result *r)
{
    uint64_t random = scene->seed * 0x9e3779b97f4a7c15u + 5;
    sfem_modes_def def = sfem_default_modes_def();
    sfem_model_def odd = linear_model_def();
    sfem_material material[2];
    stress_scene mean = *scene; /* the body of a family that has the faults */
    static const stress_family of[3] = {STRESS_SLIVER, STRESS_SPIN, STRESS_SPIN};
    sfem_modes modes[2];
    sfem_model *model = NULL;
    sfem_mesh mesh;
    sfem_int *index, pins[4], i;
    sfem_error err;
    sfem_status status;
    stress_body s;
    int k, ratio, pinned;
    mean.family = of[stress_below(&random, 3)];
    memset(&s, 0, sizeof s);
    memset(modes, 0, sizeof modes);
    s.scene = &mean;
    if (stress_mesh(&s, &random, &err)) return;
    stress_odd_mesh(&s, &random, &mesh);
    index = (sfem_int *)malloc((size_t)mesh.tets * sizeof *index);
    ratio = stress_below(&random, 3);
    pinned = stress_below(&random, 5); /* 0 free; a node, two, three; 4 an axis of one */
    for (i = 0; i < mesh.tets; ++i) index[i] = stress_below(&random, 2);
    material[0] = linear_material();
    material[0].young = scene->young;
    material[0].poisson = scene->poisson;
    material[1] = material[0];
    if (ratio == 1) material[1].young *= 1e6;
    if (ratio == 2) material[1].density *= 1e6;
    odd.mesh = &mesh;
    odd.materials = material;
    odd.material_count = 2;
    odd.tet_material = index;
    for (i = 0; i < 4; ++i) pins[i] = (i * 7) % mesh.nodes;
    def.pins = pins;
    def.pin_count = pinned < 4 ? pinned : 1;
    def.pin_axes = pinned == 4 ? (const unsigned char *)"\001" : NULL;
    def.modes = 10;
    def.rigid = 1;
    def.seed = (uint32_t)scene->seed;
    status = sfem_model_create(&odd, &model, &err);
    for (k = 0; k < 2 && !status; ++k) {
        def.dense = k;
        status = sfem_modes_create(model, &def, &modes[k], &err);
    }
    r->steps = status ? 0 : (int)modes[0].info.solves;
    if (status)
        stress_failed(r, &err);
    else
        stress_compare_modes(model, &modes[0], &modes[1], r);
    snprintf(r->why + strlen(r->why), sizeof r->why - strlen(r->why), " [%d nodes, %s, pins %d]",
             (int)mesh.nodes,
             ratio == 0   ? "one material"
             : ratio == 1 ? "moduli 1e6"
                          : "masses 1e6",
             pinned);
    (void)form;
    sfem_modes_free(&modes[0]);
    sfem_modes_free(&modes[1]);
    sfem_model_free(model);
    free(index);
    free(mesh.x);
    free(mesh.tet);
    stress_free(&s);
}

/* ---- running one, and the list of all ---- */

STRESS_STATIC stress_result stress_run(const stress_scene *scene, stress_form form)
{
    const clock_t began = clock();
    stress_result r;
    memset(&r, 0, sizeof r);
    if (scene->family == STRESS_MODAL)
        stress_run_modal(scene, form, &r);
    else if (scene->family == STRESS_STREAM)
        stress_run_stream(scene, form, &r);
    else if (scene->family == STRESS_EIGEN)
        stress_run_eigen(scene, form, &r);
    else
        stress_run_body(scene, form, &r);
    r.seconds = (double)(clock() - began) / CLOCKS_PER_SEC;
    return r;
}

STRESS_STATIC void stress_name(stress_scene *s, const char *kind)
{
    static const char *const law[4] = {"linear", "corot", "stvk", "neo"};
    snprintf(s->name, sizeof s->name, "%s%s/%s/%.3g/%.4g/%.3g", kind,
             stress_family_name((int)s->family), law[s->law], s->young, s->poisson, s->h);
    if (s->quality > 0)
        snprintf(s->name + strlen(s->name), sizeof s->name - strlen(s->name), "/q%.3g", s->quality);
}

/* A calm scene has a step that resolves it, a given part of the slowest period, about 3 lengths/speed of sound. */
STRESS_STATIC void stress_calm_step(stress_scene *s, double part)
{
    const double bar =
        s->family == STRESS_CALM ? 6.283 / 1.6 : 2.0; /* sqrt(rho/Y) times this: held, free */
    s->h = part * bar * 0.5 * sqrt(1000 / s->young) * (s->family == STRESS_CALM ? 2.5 : 1);
}

/* The k-th scene of 6 s, or 0 past the end. */
STRESS_STATIC int stress_fixed_six(int k, stress_scene *s)
{
    static const struct {
        sfem_law law;
        double young, poisson, h;
    } calm[12] =
        {
            {SFEM_COROTATIONAL, 2e5, 0.38, 1.0 / 60},  {SFEM_COROTATIONAL, 2e5, 0.38, 1.0 / 60},
            {SFEM_COROTATIONAL, 1e6, 0.38, 1.0 / 30},  {SFEM_COROTATIONAL, 1e6, 0.38, 1.0 / 30},
            {SFEM_COROTATIONAL, 1e6, 0.45, 1.0 / 240}, {SFEM_COROTATIONAL, 1e6, 0.45, 1.0 / 240},
            {SFEM_COROTATIONAL, 1e7, 0.3, 1.0 / 60},   {SFEM_COROTATIONAL, 1e7, 0.3, 1.0 / 60},
            {SFEM_STVK, 1e6, 0.38, 1.0 / 60},          {SFEM_STVK, 1e6, 0.38, 1.0 / 60},
            {SFEM_NEOHOOKEAN, 1e6, 0.45, 1.0 / 60},    {SFEM_NEOHOOKEAN, 1e6, 0.45, 1.0 / 60},
        },
      other[12] = {
          {SFEM_LINEAR, 1e5, 0.3, 1.0 / 60},        {SFEM_LINEAR, 1e7, 0.3, 1.0 / 30},
          {SFEM_LINEAR, 1e5, 0.45, 1.0 / 240},      {SFEM_LINEAR, 1e6, 0.3, 1.0 / 60},
          {SFEM_COROTATIONAL, 1e4, 0.45, 1.0 / 60}, {SFEM_COROTATIONAL, 1e6, 0.3, 1.0 / 60},
          {SFEM_COROTATIONAL, 1e8, 0.3, 1.0 / 30},  {SFEM_COROTATIONAL, 1e6, 0.3, 1.0 / 240},
          {SFEM_STVK, 1e6, 0.3, 1.0 / 60},          {SFEM_STVK, 1e9, 0.3, 1.0 / 30},
          {SFEM_NEOHOOKEAN, 1e5, 0.45, 1.0 / 60},   {SFEM_NEOHOOKEAN, 1e8, 0.49, 1.0 / 240},
      };
    const int each = 12, family = STRESS_FALL + k / each, which = k % each;
    const int is_calm = family <= STRESS_ROLL;
    if (family >= STRESS_FAMILY_COUNT) return 0;
    s->family = (stress_family)family;
    s->law = is_calm ? calm[which].law : other[which].law;
    s->young = is_calm ? calm[which].young : other[which].young;
    s->poisson = is_calm ? calm[which].poisson : other[which].poisson;
    s->h = is_calm ? calm[which].h : other[which].h;
    if (family == STRESS_DROP && which % 2) s->young /= 10;
    if (stress_is_unstructured(s->family)) s->quality = which % 2 ? 0.01 : 0.1;
    s->steps = (int)floor(6 / s->h + 0.5);
    stress_name(s, "");
    return 1;
}

/* The k-th scene of the fixed list, or 0 past its end. */
STRESS_STATIC int stress_fixed(int k, stress_scene *s)
{
    static const struct {
        sfem_law law;
        double young, poisson, h;
        int steps;
    } body[12] = {
        {SFEM_LINEAR, 1e5, 0.3, 1.0 / 60, 2000},
        {SFEM_COROTATIONAL, 1e3, 0.3, 0.01, 3000},
        {SFEM_COROTATIONAL, 1e4, 0.45, 1.0 / 30, 2000},
        {SFEM_COROTATIONAL, 1e6, 0.3, 1.0 / 60, 5000},
        {SFEM_COROTATIONAL, 1e8, 0.3, 1e-3, 5000},
        {SFEM_COROTATIONAL, 1e11, 0.3, 0.1, 2000},
        {SFEM_COROTATIONAL, 1e6, 0.3, 1e-4, 10000},
        {SFEM_STVK, 1e5, 0.3, 1.0 / 120, 2000},
        {SFEM_STVK, 1e9, 0.3, 1.0 / 30, 2000},
        {SFEM_NEOHOOKEAN, 1e4, 0.45, 1.0 / 60, 2000},
        {SFEM_NEOHOOKEAN, 1e6, 0.3, 0.1, 2000},
        {SFEM_NEOHOOKEAN, 1e11, 0.49, 1e-3, 5000},
    };
    const int each = 12, family = k / each, which = k % each;
    memset(s, 0, sizeof *s);
    s->seed = (uint64_t)(k + 1);
    if (family >= STRESS_FALL) return stress_fixed_six(k - each * STRESS_FALL, s);
    s->family = (stress_family)family;
    s->law = body[which].law;
    s->young = body[which].young;
    s->poisson = s->family == STRESS_SOLID ? 0.4999 : body[which].poisson;
    s->h = body[which].h;
    s->steps = body[which].steps;
    if (family >= STRESS_MODAL) s->law = SFEM_LINEAR;
    if (s->family <= STRESS_TUMBLE) {
        s->steps = 10000;
        stress_calm_step(s, which % 3 == 0 ? 0.01 : which % 3 == 1 ? 0.02 : 0.04);
    }
    stress_name(s, "");
    return 1;
}

/* The scene of a seed. */
STRESS_STATIC void stress_sampled(uint64_t seed, stress_scene *s)
{
    uint64_t random = seed * 0x9e3779b97f4a7c15u + 31;
    memset(s, 0, sizeof *s);
    s->family =
        (stress_family)(STRESS_HANG + stress_below(&random, STRESS_SAMPLED_END - STRESS_HANG));
    s->law = (sfem_law)stress_below(&random, 4);
    s->young = pow(10, stress_uniform(&random, 3, 11));
    s->poisson = s->family == STRESS_SOLID ? 0.4999 : stress_uniform(&random, 0, 0.49);
    s->h = pow(10, stress_uniform(&random, -4, -1));
    s->steps = 2000 + stress_below(&random, 3000);
    s->seed = seed;
    if (s->family >= STRESS_MODAL) s->law = SFEM_LINEAR;
    stress_name(s, "sampled:");
}

#endif
