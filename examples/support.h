/* support.h - what the examples share: time, files, options, selections; with picture.h and plot.h.
 *
 * Include it first (it asks for POSIX). It knows nothing of softfem.h. What fails here ends the
 * program with a message and exit code 2.
 *
 *     time, files   ex_seconds  ex_fail  ex_new  ex_make_directory  ex_path  ex_progress
 *     options       ex_parse  ex_given  ex_text  ex_nth  ex_real  ex_positive  ex_integer  ex_reals
 *                   ex_count  ex_choice  ex_steps
 *     selections    ex_selection_of  ex_selected
 *     numbers       ex_clamp  ex_apart  ex_nice  ex_short  ex_gauss
 */
#ifndef SFEM_EXAMPLES_SUPPORT_H
#define SFEM_EXAMPLES_SUPPORT_H

#ifndef _POSIX_C_SOURCE
#define _POSIX_C_SOURCE 200809L
#endif
#include <errno.h>
#include <math.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

#define EX_STATIC static __attribute__((unused))

/* --------------------------------------------------------------------------------------------
 * time, files, terminal
 * -------------------------------------------------------------------------------------------- */

EX_STATIC double ex_seconds(void) /* of a clock that only goes forward */
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

__attribute__((format(printf, 1, 2), noreturn)) EX_STATIC void ex_fail(const char *format, ...)
{
    va_list list;
    va_start(list, format);
    fflush(stdout);
    vfprintf(stderr, format, list);
    fputc('\n', stderr);
    va_end(list);
    exit(2);
}

EX_STATIC void *ex_new(size_t count, size_t size)
{
    void *memory = calloc(count ? count : 1, size);
    if (!memory) ex_fail("out of memory");
    return memory;
}

EX_STATIC FILE *ex_open(const char *path)
{
    FILE *f = fopen(path, "wb");
    if (!f) ex_fail("%s: %s", path, strerror(errno));
    return f;
}

EX_STATIC void ex_close(FILE *f, const char *path)
{
    const int failed = ferror(f);
    if (fclose(f) || failed) ex_fail("%s: not all could be written", path);
}

EX_STATIC void ex_make_directory(const char *path) /* and those above it */
{
    char part[1024];
    size_t i, length = strlen(path);
    if (!length) ex_fail("the name of a directory is empty; this one is .");
    if (length >= sizeof part) ex_fail("%s: too long", path);
    for (i = 1; i <= length; ++i) {
        if (path[i] != '/' && path[i]) continue;
        memcpy(part, path, i);
        part[i] = 0;
        if (mkdir(part, 0777) && errno != EEXIST) ex_fail("%s: %s", part, strerror(errno));
    }
}

EX_STATIC const char *ex_path(const char *directory, const char *name) /* good for four calls */
{
    static char path[4][1024];
    static int turn;
    turn = (turn + 1) % 4;
    if (snprintf(path[turn], sizeof *path, "%s/%s", directory, name) >= (int)sizeof *path)
        ex_fail("%s: too long", directory);
    return path[turn];
}

/* A bar on stderr if that is a terminal, else nothing; gone when done == total. */
EX_STATIC void ex_progress(const char *what, long done, long total)
{
    static double start, last;
    const double now = ex_seconds(), part = total > 0 ? (double)done / (double)total : 1;
    const int width = 32, full = (int)(part * width);
    int i;
    if (!isatty(2)) return;
    if (done == 0) start = now;
    if (done < total && done > 0 && now - last < 0.05) return;
    last = now;
    fprintf(stderr, "\r\033[K");
    if (done >= total) return;
    fprintf(stderr, "%s [", what);
    for (i = 0; i < width; ++i) fputc(i < full ? '#' : '.', stderr);
    fprintf(stderr, "] %3.0f %%", 100 * part);
    if (done > 0) fprintf(stderr, ", %.0f s left", (now - start) * (1 / part - 1));
    fflush(stderr);
}

/* --------------------------------------------------------------------------------------------
 * options: one table gives the parser, the help and the defaults
 * -------------------------------------------------------------------------------------------- */

typedef struct ex_option {
    const char *name;     /* "--young", or "MESH" for what stands without a name; NULL ends */
    const char *argument; /* "E", "X,Y,Z", "one|two|three" for a choice; NULL: a flag */
    const char *initial;  /* the value if none is given, or NULL */
    const char *help;
} ex_option;

enum { EX_OPTIONS = 64, EX_REPEATS = 16 };

typedef struct ex_options {
    const char *program, *summary;
    const ex_option *table;
    const char *value[EX_OPTIONS][EX_REPEATS];
    int count[EX_OPTIONS];
} ex_options;

EX_STATIC void ex_help(const ex_options *o)
{
    const ex_option *t;
    printf("usage: %s", o->program);
    for (t = o->table; t->name; ++t)
        if (t->name[0] != '-') printf(" [%s]", t->name);
    printf(" [options]\n%s\n\n", o->summary);
    for (t = o->table; t->name; ++t) {
        char left[64];
        snprintf(left, sizeof left, "%s%s%s", t->name, t->argument ? " " : "",
                 t->argument ? t->argument : "");
        printf(strlen(left) > 26 ? "  %s\n%30s%s" : "  %-26s%s%s", left, "  ", t->help);
        printf(t->initial && *t->initial ? " [%s]\n" : "\n", t->initial);
    }
    printf("  %-26s  %s\n", "--help", "this text");
}

EX_STATIC int ex_find(const ex_options *o, const char *name)
{
    int i;
    for (i = 0; o->table[i].name; ++i)
        if (!strcmp(o->table[i].name, name)) return i;
    return -1;
}

EX_STATIC void ex_unknown(const ex_options *o, const char *name)
{
    const ex_option *t;
    fprintf(stderr, "%s: there is no %s. Known:", o->program, name);
    for (t = o->table; t->name; ++t) fprintf(stderr, " %s", t->name);
    fprintf(stderr, " --help\n");
    exit(2);
}

EX_STATIC void ex_set(ex_options *o, int i, const char *value)
{
    if (o->count[i] == EX_REPEATS) ex_fail("%s: given too often", o->table[i].name);
    o->value[i][o->count[i]++] = value;
}

/* the next argument without a name goes to the first such entry that has no value yet */
EX_STATIC void ex_positional(ex_options *o, const char *value)
{
    int i;
    for (i = 0; o->table[i].name; ++i) {
        if (o->table[i].name[0] == '-' || o->count[i]) continue;
        ex_set(o, i, value);
        return;
    }
    ex_unknown(o, value);
}

/* how often it was given on the command line */
EX_STATIC int ex_given(const ex_options *o, const char *name)
{
    const int i = ex_find(o, name);
    if (i < 0) ex_unknown(o, name);
    return o->count[i];
}

EX_STATIC const char *ex_nth(const ex_options *o, const char *name, int n) /* n < ex_given */
{
    return o->value[ex_find(o, name)][n];
}

EX_STATIC const char *ex_text(const ex_options *o, const char *name) /* the last, or the initial */
{
    const int n = ex_given(o, name);
    return n ? ex_nth(o, name, n - 1) : o->table[ex_find(o, name)].initial;
}

/* the place, from 0, of the value in the entry's "one|two|three" */
EX_STATIC int ex_choice(const ex_options *o, const char *name)
{
    const char *text = ex_text(o, name), *s = o->table[ex_find(o, name)].argument;
    const size_t length = strlen(text);
    int i;
    for (i = 0; s; ++i, s = strchr(s, '|') ? strchr(s, '|') + 1 : NULL)
        if (!strncmp(s, text, length) && (s[length] == '|' || !s[length])) return i;
    ex_fail("%s: '%s' is none of %s", name, text, o->table[ex_find(o, name)].argument);
}

/* Ends the program after --help (0) and on what is not understood (2). Takes "--name=value" too. */
EX_STATIC ex_options ex_parse(int argc, char **argv, const char *summary, const ex_option *table)
{
    ex_options o;
    int i, k;
    memset(&o, 0, sizeof o);
    o.program = argv[0];
    o.summary = summary;
    o.table = table;
    for (i = 1; i < argc; ++i) {
        char name[64];
        const char *equals = strchr(argv[i], '=');
        size_t length = strlen(argv[i]);
        if (argv[i][0] != '-' || !argv[i][1]) {
            ex_positional(&o, argv[i]);
            continue;
        }
        if (equals) length = (size_t)(equals - argv[i]);
        if (length >= sizeof name) length = sizeof name - 1;
        memcpy(name, argv[i], length);
        name[length] = 0;
        if (!strcmp(name, "--help") || !strcmp(name, "-h")) {
            ex_help(&o);
            exit(0);
        }
        k = ex_find(&o, name);
        if (k < 0) ex_unknown(&o, name);
        if (!table[k].argument) {
            if (equals) ex_fail("%s: takes no value", name);
            ex_set(&o, k, "");
        } else if (equals) {
            ex_set(&o, k, equals + 1);
        } else if (i + 1 < argc) {
            ex_set(&o, k, argv[++i]);
        } else {
            ex_fail("%s: needs %s", name, table[k].argument);
        }
        if (table[k].argument && strchr(table[k].argument, '|')) (void)ex_choice(&o, name);
    }
    return o;
}

/* Numbers X,Y,Z: exactly count of them up to the end of the text. */
EX_STATIC void ex_numbers(const char *where, const char *text, int count, double *out)
{
    const char *s = text;
    int i;
    for (i = 0; i < count; ++i) {
        char *end;
        out[i] = strtod(s, &end);
        if (end == s || *end != (i + 1 < count ? ',' : '\0'))
            ex_fail("%s: '%s' is not %s", where, text,
                    count > 1 ? "a list as asked for" : "a number");
        s = end + 1;
    }
}

EX_STATIC void ex_reals(const ex_options *o, const char *name, int count, double *out)
{
    const char *text = ex_text(o, name);
    ex_numbers(name, text ? text : "", count, out);
}

EX_STATIC double ex_real(const ex_options *o, const char *name)
{
    double x;
    ex_reals(o, name, 1, &x);
    return x;
}

EX_STATIC long ex_integer(const ex_options *o, const char *name)
{
    const double x = ex_real(o, name);
    if (!(x >= -2147483647.0 && x <= 2147483647.0) || x != floor(x))
        ex_fail("%s: '%s' is not a whole number of at most 2^31 - 1", name, ex_text(o, name));
    return (long)x;
}

/* a whole number of at least `least` */
EX_STATIC long ex_count(const ex_options *o, const char *name, long least)
{
    const long n = ex_integer(o, name);
    if (n < least) ex_fail("%s: %ld is below %ld", name, n, least);
    return n;
}

EX_STATIC double ex_positive(const ex_options *o, const char *name)
{
    const double x = ex_real(o, name);
    if (!(x > 0) || x - x != 0) ex_fail("%s: '%s' is not a number above 0", name, ex_text(o, name));
    return x;
}

/* how many steps of dt fill so many seconds */
EX_STATIC int ex_steps(double seconds, double dt)
{
    const double steps = floor(seconds / dt + 0.5);
    if (!(steps >= 1 && steps <= 1e8))
        ex_fail("%g s in steps of %g s: not between 1 and 1e8 steps", seconds, dt);
    return (int)steps;
}

/* --------------------------------------------------------------------------------------------
 * selections of nodes: 'x<0.01', 'x>0.9 & y>=0.5 | z=0', 'node=17', 'all'. & (or a comma) binds
 * closer than |. '=' allows for rounding.
 * -------------------------------------------------------------------------------------------- */

enum { EX_CONDITIONS = 32 };

typedef struct ex_condition {
    int axis;        /* 0 1 2, or 3 for the node's number, 4 for all */
    char sign;       /* '<' '>' '=' */
    int or_equal;    /* <= >= */
    int alternative; /* stands after | */
    double value;
} ex_condition;

typedef struct ex_selection {
    int count;
    ex_condition condition[EX_CONDITIONS];
} ex_selection;

/* one condition from *s on; moves *s behind it */
EX_STATIC ex_condition ex_condition_of(const char *text, const char **s)
{
    ex_condition c = {4, '=', 0, 0, 0};
    char *end;
    *s += strspn(*s, " ");
    if (!strncmp(*s, "all", 3)) {
        *s += 3 + strspn(*s + 3, " ");
        return c;
    }
    if (!strncmp(*s, "node", 4)) {
        c.axis = 3;
        *s += 4;
    } else if (**s && strchr("xyz", **s)) {
        c.axis = **s - 'x';
        ++*s;
    }
    *s += strspn(*s, " ");
    if (c.axis == 4 || !**s || !strchr("<>=", **s)) ex_fail("'%s': cannot read '%s'", text, *s);
    c.sign = *(*s)++;
    if (**s == '=') c.or_equal = *(*s)++ == '=';
    c.value = strtod(*s, &end);
    if (end == *s) ex_fail("'%s': no number at '%s'", text, *s);
    *s = end + strspn(end, " ");
    return c;
}

EX_STATIC ex_selection ex_selection_of(const char *text)
{
    ex_selection selection;
    const char *s = text;
    int alternative = 0;
    memset(&selection, 0, sizeof selection);
    for (;;) {
        ex_condition *c = &selection.condition[selection.count];
        if (selection.count == EX_CONDITIONS) ex_fail("'%s': too many conditions", text);
        *c = ex_condition_of(text, &s);
        c->alternative = alternative;
        ++selection.count;
        if (!*s) break;
        if (!strchr("&|,", *s)) ex_fail("'%s': cannot read '%s'", text, s);
        alternative = *s++ == '|';
    }
    return selection;
}

EX_STATIC int ex_selected(const ex_selection *selection, long node, const double *x)
{
    int i, holds = 1;
    for (i = 0; i < selection->count; ++i) {
        const ex_condition *c = &selection->condition[i];
        const double a = c->axis < 3 ? x[c->axis] : c->axis == 3 ? (double)node : c->value;
        const int equal = fabs(a - c->value) <= 1e-9 * (1 + fabs(c->value));
        if (c->alternative && holds) return 1;
        if (c->alternative) holds = 1;
        if (c->sign == '=' || (c->or_equal && equal))
            holds = holds && equal;
        else
            holds = holds && (c->sign == '<' ? a < c->value : a > c->value);
    }
    return holds;
}

/* --------------------------------------------------------------------------------------------
 * numbers
 * -------------------------------------------------------------------------------------------- */

/* finite, and far enough apart for ticks between them */
EX_STATIC int ex_apart(double low, double high)
{
    return high - low > 1e-10 * (fabs(low) + fabs(high)) && high - low < 1e300;
}

EX_STATIC double ex_clamp(double x, double low, double high)
{
    return x < low ? low : x > high ? high : x;
}

/* a number as short as can be beside others over the span: 0.25, 1200, 30k, 2.5M, 40u */
EX_STATIC void ex_short(char *text, size_t bytes, double x, double span)
{
    static const char *const prefix[9] = {"p", "n", "u", "m", "", "k", "M", "G", "T"};
    const double size = fabs(x);
    int k = size < 1e4 && size >= 1e-3 ? 0 : (int)floor(log10(fmax(size, 1e-300)) / 3 + 1e-9);
    if (size < 1e-9 * span) x = k = 0;
    if (k < -4 || k > 4)
        snprintf(text, bytes, "%.4g", x);
    else
        snprintf(text, bytes, "%.*g%s", span > 0 && size > 1e3 * span ? 12 : 5, x / pow(10, 3 * k),
                 prefix[k + 4]);
}

/* Gaussian noise of variance 1: the sum of twelve uniform numbers by splitmix64 [Steele et al. 2014] */
EX_STATIC double ex_gauss(uint64_t *state)
{
    double sum = -6;
    int i;
    for (i = 0; i < 12; ++i) {
        uint64_t z = (*state += 0x9e3779b97f4a7c15u);
        z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
        z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
        sum += (double)((z ^ (z >> 31)) >> 11) / 9007199254740992.0;
    }
    return sum;
}

EX_STATIC double ex_nice(double x) /* 1, 2 or 5 times a power of ten, at least x */
{
    const double power = pow(10, floor(log10(x))), f = x / power;
    return power * (f <= 1.0000001 ? 1 : f <= 2.0000001 ? 2 : f <= 5.0000001 ? 5 : 10);
}

#include "picture.h"
#include "plot.h"

#endif
