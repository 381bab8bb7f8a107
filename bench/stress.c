/* Which integrator survives what: the scenes of stress.h, a fixed list of them and sampled ones, by every
 * form of every integrator; a table of survival by family, and each failure with what reruns it.
 *
 *     build/bench/stress [--jobs N] [--fixed N] [--sampled N] [--first SEED] [--quick] [--every N]
 *     build/bench/stress --scene NAME [--seed N] [--form FORM]
 *     build/bench/stress --list | --help
 *
 * The default goes through all scenes; the others, which the default is compared with, through the fixed
 * ones (every Nth of them), with a quarter of the steps where they iterate. NAME is of the fixed list, or a
 * family: then the sampled scene of the seed, or the fixed ones of the family. Status 1 if the default fails. */
#define _DEFAULT_SOURCE
#include "stress.h"

#include <sys/mman.h>
#include <sys/wait.h>
#include <unistd.h>

typedef struct job {
    stress_scene scene;
    stress_form form;
    int done;
    stress_result result;
} job;

typedef struct board {
    int next, count;
    job job[];
} board;

static const char *const usage =
    "usage: stress [--jobs N, 2] [--fixed N, all] [--sampled N, 200] [--first SEED, 1000]\n"
    "              [--form FORM] [--every N, 1] [--quick]\n"
    "       stress --scene NAME [--seed N] [--form FORM, default | all]\n"
    "       stress --list | --help\n"
    "  --every N   other forms than the default: every Nth of the fixed scenes only\n"
    "  --quick     40 fixed scenes, 20 sampled\n";

/* Is every argument an option that there is, with a value that it takes? */
static int understood(int argc, char **argv)
{
    static const char *const counts[] = {"--jobs",  "--fixed", "--sampled",
                                         "--first", "--every", "--seed"};
    static const char *const alone[] = {"--quick", "--list", "--help"};
    int i, k, f;
    for (i = 1; i < argc; ++i) {
        const char *value = i + 1 < argc ? argv[i + 1] : "";
        int known = !strcmp(argv[i], "--scene") && *value ? 2 : 0;
        for (k = 0; k < 3; ++k)
            if (!strcmp(argv[i], alone[k])) known = 1;
        for (k = 0; k < 6; ++k)
            if (!strcmp(argv[i], counts[k]) && *value &&
                strspn(value, "0123456789") == strlen(value))
                known = 2;
        for (f = 0; f <= STRESS_FORM_COUNT && !strcmp(argv[i], "--form"); ++f)
            if (!strcmp(value, f < STRESS_FORM_COUNT ? stress_form_name(f) : "all")) known = 2;
        if (!known) {
            fprintf(stderr, "stress: %s%s%s\n", argv[i], *value ? " " : "", value);
            return 0;
        }
        i += known - 1;
    }
    return 1;
}

static int option(int argc, char **argv, const char *name, const char **value)
{
    int i;
    for (i = 1; i < argc; ++i) {
        if (strcmp(argv[i], name)) continue;
        if (value && i + 1 < argc) *value = argv[i + 1];
        return 1;
    }
    return 0;
}

static uint64_t number(int argc, char **argv, const char *name, uint64_t otherwise)
{
    const char *text = NULL;
    option(argc, argv, name, &text);
    return text ? strtoull(text, NULL, 10) : otherwise;
}

static int at_least_one(int argc, char **argv, const char *name, uint64_t otherwise)
{
    const uint64_t n = number(argc, argv, name, otherwise);
    return n < 1 ? 1 : (int)n;
}

/* ---- one scene ---- */

static void report(const stress_scene *s, stress_form form, const stress_result *r)
{
    printf("%-34s seed %-6llu %-12s %c %5d+%-5d steps %.2f s\n", s->name,
           (unsigned long long)s->seed, stress_form_name((int)form), stress_letter((int)r->verdict),
           r->steps, r->damped_steps, r->seconds);
    printf("    energy +%.3g S, form %.1e, momenta %.1e %.1e, shape %.3g, lost a swing %.3g, "
           "rejected %.3g\n",
           r->excess, r->drift, r->linear, r->angular, r->shape, r->lost, r->rejected);
    if (r->moved > 0) printf("    moved by %.2f of its length\n", r->moved);
    if (r->why[0]) printf("    %s: %s\n", stress_verdict_about((int)r->verdict), r->why);
    fflush(stdout);
}

static int run_some(const char *name, uint64_t seed, const char *form)
{
    stress_scene s;
    int k, f, found = 0;
    for (k = 0; stress_fixed(k, &s); ++k) {
        if (strcmp(s.name, name) && (seed || strcmp(stress_family_name((int)s.family), name)))
            continue;
        for (f = 0; f < STRESS_FORM_COUNT; ++f) {
            stress_result r;
            if (strcmp(stress_form_name(f), form) && strcmp(form, "all")) continue;
            if (!stress_applies(s.family, (stress_form)f)) continue;
            r = stress_run(&s, (stress_form)f);
            report(&s, (stress_form)f, &r);
            ++found;
        }
    }
    if (!found && seed) {
        stress_sampled(seed, &s);
        for (f = 0; f < STRESS_FORM_COUNT; ++f) {
            stress_result r;
            if (strcmp(stress_form_name(f), form) && strcmp(form, "all")) continue;
            if (!stress_applies(s.family, (stress_form)f)) continue;
            r = stress_run(&s, (stress_form)f);
            report(&s, (stress_form)f, &r);
            ++found;
        }
    }
    if (!found) fprintf(stderr, "no scene %s (try --list)\n", name);
    return !found;
}

/* ---- all ---- */

static void work(board *b)
{
    int k;
    while ((k = __atomic_fetch_add(&b->next, 1, __ATOMIC_RELAXED)) < b->count) {
        job *j = &b->job[k];
        j->result = stress_run(&j->scene, j->form);
        __atomic_store_n(&j->done, 1, __ATOMIC_RELEASE);
        if (j->result.verdict != STRESS_IS_PASSED || j->result.seconds > 10) {
            report(&j->scene, j->form, &j->result);
            printf("    %d of %d\n", k + 1, b->count);
            fflush(stdout);
        }
    }
}

static void add(board *b, const stress_scene *s, stress_form form)
{
    job *j = &b->job[b->count++];
    j->scene = *s;
    j->form = form;
    if (form >= STRESS_FORM_NEWMARK && form <= STRESS_FORM_BATHE) j->scene.steps /= 4;
    if (form == STRESS_FORM_BEYOND || form == STRESS_FORM_CENTRAL) j->scene.steps = 2000;
}

static void print_table(const board *b)
{
    int count[STRESS_FORM_COUNT][STRESS_FAMILY_COUNT][STRESS_VERDICT_COUNT];
    int f, k, v;
    memset(count, 0, sizeof count);
    for (k = 0; k < b->count; ++k)
        ++count[b->job[k].form][b->job[k].scene.family]
               [b->job[k].done ? (int)b->job[k].result.verdict : STRESS_IS_ERROR];
    printf(
        "\nSurvival: passed of all; after a slash those in another minimum (k) or refused (r)\n%-12s",
        "");
    for (k = 0; k < STRESS_FAMILY_COUNT; ++k) printf(" %8s", stress_family_name(k));
    printf("      all  failed  seconds\n");
    for (f = 0; f < STRESS_FORM_COUNT; ++f) {
        int all = 0, passed = 0, other = 0;
        double seconds = 0;
        for (k = 0; k < b->count; ++k)
            if ((int)b->job[k].form == f) seconds += b->job[k].result.seconds;
        printf("%-12s", stress_form_name(f));
        for (k = 0; k < STRESS_FAMILY_COUNT; ++k) {
            char cell[32];
            const int *c = count[f][k];
            int sum = 0;
            for (v = 0; v < STRESS_VERDICT_COUNT; ++v) sum += c[v];
            snprintf(cell, sizeof cell, sum ? "%d/%d" : "-", c[STRESS_IS_PASSED], sum);
            if (c[STRESS_IS_MINIMUM]) snprintf(cell + strlen(cell), 8, "k%d", c[STRESS_IS_MINIMUM]);
            if (c[STRESS_IS_REFUSED]) snprintf(cell + strlen(cell), 8, "r%d", c[STRESS_IS_REFUSED]);
            printf(" %8s", cell);
            all += sum;
            passed += c[STRESS_IS_PASSED];
            other += c[STRESS_IS_MINIMUM] + c[STRESS_IS_REFUSED];
        }
        printf("  %3d/%-3d %4d %10.1f\n", passed, all, all - passed - other, seconds);
    }
    printf("%-12s", "seconds");
    for (k = 0; k < STRESS_FAMILY_COUNT; ++k) {
        double seconds = 0;
        for (f = 0; f < b->count; ++f)
            if ((int)b->job[f].scene.family == k) seconds += b->job[f].result.seconds;
        printf(" %8.1f", seconds);
    }
    printf("   of the processor\n");
}

static void print_failures(const board *b)
{
    int k, f, v;
    printf("\nBy verdict\n%-12s", "");
    for (v = 0; v < STRESS_VERDICT_COUNT; ++v) printf("  %c %3s", stress_letter(v), "");
    printf("\n");
    for (f = 0; f < STRESS_FORM_COUNT; ++f) {
        int count[STRESS_VERDICT_COUNT] = {0}, all = 0;
        for (k = 0; k < b->count; ++k)
            if ((int)b->job[k].form == f) ++count[b->job[k].result.verdict], ++all;
        if (!all) continue;
        printf("%-12s", stress_form_name(f));
        for (v = 0; v < STRESS_VERDICT_COUNT; ++v) printf(" %5d", count[v]);
        printf("   %s\n", stress_form_about(f));
    }
    for (v = 0; v < STRESS_VERDICT_COUNT; ++v)
        printf("  %c %s\n", stress_letter(v), stress_verdict_about(v));
    printf("\nWhat did not pass (rerun: build/bench/stress --scene NAME --seed N --form FORM)\n");
    for (f = 0; f < STRESS_FORM_COUNT; ++f)
        for (k = 0; k < b->count; ++k) {
            const job *j = &b->job[k];
            if ((int)j->form != f || (j->done && j->result.verdict == STRESS_IS_PASSED)) continue;
            printf("%-11s %c --scene %s --seed %llu  %s\n", stress_form_name(f),
                   j->done ? stress_letter((int)j->result.verdict) : '!', j->scene.name,
                   (unsigned long long)j->scene.seed, j->done ? j->result.why : "the process died");
        }
}

static int print_default(const board *b)
{
    double excess[STRESS_FAMILY_COUNT] = {0}, linear[STRESS_FAMILY_COUNT] = {0},
           angular[STRESS_FAMILY_COUNT] = {0}, rejected[STRESS_FAMILY_COUNT] = {0},
           lost[STRESS_FAMILY_COUNT] = {0}, drift[STRESS_FAMILY_COUNT] = {0}, seconds = 0;
    int64_t steps = 0;
    int k, failed = 0, count[STRESS_FAMILY_COUNT] = {0};
    for (k = 0; k < b->count; ++k) {
        const stress_result *r = &b->job[k].result;
        const int f = (int)b->job[k].scene.family;
        seconds += r->seconds;
        steps += r->steps + r->damped_steps;
        if (b->job[k].form != STRESS_FORM_DEFAULT) continue;
        excess[f] = fmax(excess[f], r->excess);
        drift[f] = fmax(drift[f], r->drift);
        linear[f] = fmax(linear[f], r->linear);
        angular[f] = fmax(angular[f], r->angular);
        lost[f] = fmax(lost[f], r->lost);
        rejected[f] += r->rejected;
        ++count[f];
        failed +=
            !b->job[k].done || (r->verdict != STRESS_IS_PASSED && r->verdict != STRESS_IS_MINIMUM);
    }
    printf("\nThe default: worst in each family (linear: change of what linear bodies conserve; "
           "modal: of\n"
           "energy; stream, eigen: error, see stress.h)\n");
    printf("%-8s %9s %9s %9s %9s %9s %9s\n", "", "Ec/S", "linear", "momentum", "angular", "lost",
           "rejected");
    for (k = 0; k < STRESS_FAMILY_COUNT; ++k)
        if (count[k])
            printf("%-8s %9.2g %9.1e %9.1e %9.1e %9.2g %9.2g   %s\n", stress_family_name(k),
                   excess[k], drift[k], linear[k], angular[k], lost[k], rejected[k] / count[k],
                   stress_family_about(k));
    printf("\n%d runs, %lld steps, %.0f s of processor time; the default fails %d\n", b->count,
           (long long)steps, seconds, failed);
    return failed;
}

int main(int argc, char **argv)
{
    const int quick = option(argc, argv, "--quick", NULL);
    const int fixed = (int)number(argc, argv, "--fixed", quick ? 40 : 100000);
    const int sampled = (int)number(argc, argv, "--sampled", quick ? 20 : 200);
    const uint64_t first = number(argc, argv, "--first", 1000);
    const int jobs = at_least_one(argc, argv, "--jobs", 2),
              every = at_least_one(argc, argv, "--every", 1);
    const char *scene = NULL, *form = stress_form_name(STRESS_FORM_DEFAULT);
    stress_scene s;
    board *b;
    int k, f, total;
    if (!understood(argc, argv) || option(argc, argv, "--help", NULL)) {
        const int asked = option(argc, argv, "--help", NULL);
        fputs(usage, asked ? stdout : stderr);
        return asked ? 0 : 2;
    }
    option(argc, argv, "--form", &form);
    if (option(argc, argv, "--list", NULL)) {
        for (k = 0; stress_fixed(k, &s); ++k) printf("%s\n", s.name);
        return 0;
    }
    if (option(argc, argv, "--scene", &scene) && scene)
        return run_some(scene, number(argc, argv, "--seed", 0), form);
    for (total = 0; total < fixed && stress_fixed(total, &s); ++total) continue;
    b = (board *)mmap(NULL,
                      sizeof *b + ((size_t)(total + sampled) * STRESS_FORM_COUNT) * sizeof(job),
                      PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
    if (b == MAP_FAILED) return 1;
    for (f = STRESS_FORM_COUNT - 1; f >= 0; --f) { /* the slow ones first: they end together */
        const int only = option(argc, argv, "--form", NULL);
        if (only && strcmp(form, "all") && strcmp(form, stress_form_name(f))) continue;
        for (k = 0; k < total; ++k)
            if ((f == STRESS_FORM_DEFAULT || k % every == 0) && stress_fixed(k, &s) &&
                stress_applies(s.family, (stress_form)f))
                add(b, &s, (stress_form)f);
        for (k = 0; k < sampled && f == STRESS_FORM_DEFAULT; ++k) {
            stress_sampled(first + (uint64_t)k, &s);
            add(b, &s, STRESS_FORM_DEFAULT);
        }
    }
    printf("%d fixed scenes, %d sampled from seeds %llu..%llu, %d runs, %d processes\n", total,
           sampled, (unsigned long long)first, (unsigned long long)(first + (uint64_t)sampled - 1),
           b->count, jobs);
    fflush(stdout);
    for (k = 0; k < jobs; ++k)
        if (fork() == 0) {
            work(b);
            _exit(0);
        }
    while (wait(NULL) > 0) continue;
    print_table(b);
    print_failures(b);
    return print_default(b) > 0;
}
