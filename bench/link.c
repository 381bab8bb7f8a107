/* What a lossy link costs and spoils: bytes a step, nanoseconds a packet, and distortion against loss
 * rate, by what is taken for what is lost and by how often a key frame comes.
 *
 * The motion is that of 20 oscillators of 1.2 to 46 Hz, damped by 2 %, that a hand pushes about: its
 * force is held, moved and let go at random. The distortion is the root mean square over STEPS steps and
 * all modes of q received minus q true, over that of q; mass-normalised modes make it that of all nodes,
 * weighted by mass. Losses are independent, of key frames as of others. `twice`: each packet is sent
 * again two steps later; `late`: what is lost comes two steps later after all.
 * Everything follows from a seed. Pin it:
 *     taskset -c 1 build/bench/link [--quick]                                                      */
#define _POSIX_C_SOURCE 200809L
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "bench.h"

#define RUNS 15

enum { MOST = 64, DELAY = 2, PACKET = 32 + 24 * MOST };

static double uniform(uint64_t *state) /* splitmix64 [Steele, Lea, Flood 2014] */
{
    uint64_t z = (*state += 0x9e3779b97f4a7c15u);
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
    return (double)((z ^ (z >> 31)) >> 11) / 9007199254740992.0;
}

/* ---- a motion ---- */

typedef struct motion {
    int m;
    double h, hand, target; /* s; force of the hand on each mode, and where it goes */
    uint64_t random;
    double k[MOST], c[MOST], q[MOST], v[MOST], a[MOST];
} motion;

static motion motion_new(int m, double h)
{
    motion s;
    int i;
    memset(&s, 0, sizeof s);
    s.m = m;
    s.h = h;
    s.random = 1;
    for (i = 0; i < m; ++i) {
        const double omega = 2 * 3.14159265358979 * 1.2 * pow(1 + i, 1.22);
        s.k[i] = omega * omega;
        s.c[i] = 2 * 0.02 * omega;
    }
    return s;
}

static void motion_step(motion *s)
{
    const double h = s->h;
    int i;
    if (uniform(&s->random) < h / 0.8)
        s->target = uniform(&s->random) < 0.4 ? 0 : 20 * uniform(&s->random) - 10;
    s->hand +=
        (s->target - s->hand) * (s->target != 0 ? 1 - exp(-h / 0.08) : 1); /* lets go at once */
    for (i = 0; i < s->m; ++i) {
        const double q = s->q[i] + h * s->v[i] + h * h / 4 * s->a[i], v = s->v[i] + h / 2 * s->a[i];
        const double force = s->hand * cos(1.7 * i);
        s->a[i] = (force - s->c[i] * v - s->k[i] * q) / (1 + h / 2 * s->c[i] + h * h / 4 * s->k[i]);
        s->q[i] = q + h * h / 4 * s->a[i];
        s->v[i] = v + h / 2 * s->a[i];
    }
}

/* ---- distortion ---- */

typedef struct setting {
    sfem_lost lost;
    int key_every, percent, twice, late, single;
} setting;

typedef struct packet {
    unsigned char byte[PACKET];
    size_t bytes;
    int kept; /* arrives DELAY steps later */
} packet;

static double distortion(const setting *o, double h, int steps, double *bytes_a_step)
{
    static packet ring[DELAY + 1];
    motion s = motion_new(20, h);
    sfem_link_def def = sfem_default_link_def();
    sfem_sender *sender;
    sfem_receiver *receiver;
    sfem_error err;
    uint64_t losses = 77;
    double off = 0, all = 0, bytes = 0;
    int i, k;
    def.modes = s.m;
    def.h = h;
    def.key_every = o->key_every;
    def.precision = o->single ? SFEM_MIXED : SFEM_DOUBLE;
    def.lost = o->lost;
    def.stiffness = s.k;
    def.damping = s.c;
    bench_must(sfem_sender_create(&def, &sender, &err), &err);
    bench_must(sfem_receiver_create(&def, &receiver, &err), &err);
    memset(ring, 0, sizeof ring);
    for (i = 0; i <= steps; ++i) {
        packet *p = &ring[i % (DELAY + 1)], *old = &ring[(i + 1) % (DELAY + 1)];
        int lost;
        bench_must(
            sfem_sender_write(sender, s.q, s.v, s.a, p->byte, sizeof p->byte, &p->bytes, &err),
            &err);
        bytes += (double)p->bytes * (o->twice ? 2 : 1);
        lost = i > 0 && 100 * uniform(&losses) < o->percent;
        p->kept = o->twice || (o->late && lost);
        if (!lost) sfem_receiver_read(receiver, p->byte, p->bytes);
        if (i > DELAY && old->kept && (!o->twice || 100 * uniform(&losses) >= o->percent))
            sfem_receiver_read(receiver, old->byte, old->bytes);
        if (i) sfem_receiver_step(receiver);
        for (k = 0; k < s.m; ++k) {
            const double d = sfem_receiver_coordinates(receiver)[k] - s.q[k];
            off += d * d;
            all += s.q[k] * s.q[k];
        }
        motion_step(&s);
    }
    sfem_sender_free(sender);
    sfem_receiver_free(receiver);
    if (bytes_a_step) *bytes_a_step = bytes / (steps + 1);
    return sqrt(off / all);
}

static void table(double h, int steps)
{
    static const char *const name[4] = {"zero (source)", "held", "extrapolated", "predicted"};
    static const int every[3] = {10, 30, 0}, percent[6] = {0, 1, 5, 10, 20, 30};
    setting o;
    double bytes;
    int e, l, k, extra;
    printf("\ndistortion, h = 1/%.0f s, 20 modes, %d steps; bytes a step as floats\n", 1 / h,
           steps);
    printf("  %-16s %-14s %6s", "what is lost is", "key frames", "bytes");
    for (k = 0; k < 6; ++k) printf("%7d %%", percent[k]);
    for (e = 0; e < 3; ++e) {
        for (l = 0; l < 4; ++l) {
            for (extra = 0; extra < (every[e] == 30 ? 3 : 1); ++extra) {
                char keys[32];
                memset(&o, 0, sizeof o);
                o.lost = (sfem_lost)l;
                o.key_every = every[e];
                o.single = 1;
                o.late = extra == 1;
                o.twice = extra == 2;
                snprintf(keys, sizeof keys, every[e] ? "every %d%s" : "the first", every[e],
                         o.late    ? ", late"
                         : o.twice ? ", twice"
                                   : "");
                distortion(&o, h, 300, &bytes);
                printf("\n  %-16s %-14s %6.0f", name[l], keys, bytes);
                for (k = 0; k < 6; ++k) {
                    o.percent = percent[k];
                    printf(" %8.2g", distortion(&o, h, steps, NULL));
                }
            }
        }
    }
    printf("\n");
}

/* ---- bytes and time ---- */

static void costs(void)
{
    static const int modes[3] = {20, 40, 60};
    int which, single;
    printf("packets, bytes and ns (median of %d)\n  %5s %8s %6s %6s %8s %8s %8s %8s\n", RUNS,
           "modes", "numbers", "bytes", "key", "write", "read", "step", "predict");
    for (which = 0; which < 3; ++which) {
        for (single = 0; single < 2; ++single) {
            enum { COUNT = 4000 };
            motion s = motion_new(modes[which], 1 / 60.0);
            sfem_link_def def = sfem_default_link_def();
            static packet p[COUNT + 1];
            double t[4][RUNS];
            sfem_error err;
            int run, i;
            def.modes = s.m;
            def.key_every = 0;
            def.precision = single ? SFEM_MIXED : SFEM_DOUBLE;
            def.lost = SFEM_LOST_PREDICTED;
            def.stiffness = s.k;
            def.damping = s.c;
            for (i = 0; i < 100; ++i) motion_step(&s);
            for (run = 0; run < RUNS; ++run) {
                sfem_sender *sender;
                sfem_receiver *receiver;
                bench_must(sfem_sender_create(&def, &sender, &err), &err);
                bench_must(sfem_receiver_create(&def, &receiver, &err), &err);
                t[0][run] = bench_seconds();
                for (i = 0; i <= COUNT; ++i)
                    bench_must(sfem_sender_write(sender, s.q, s.v, s.a, p[i].byte, sizeof p[i].byte,
                                                 &p[i].bytes, &err),
                               &err);
                t[0][run] = bench_seconds() - t[0][run];
                sfem_receiver_read(receiver, p[0].byte, p[0].bytes);
                t[1][run] = t[2][run] = 0;
                for (i = 1; i <= COUNT; i += 32) { /* a window full of packets, then their steps */
                    const double start = bench_seconds();
                    double middle;
                    int k;
                    for (k = i; k < i + 32 && k <= COUNT; ++k)
                        sfem_receiver_read(receiver, p[k].byte, p[k].bytes);
                    middle = bench_seconds();
                    for (k = i; k < i + 32 && k <= COUNT; ++k) sfem_receiver_step(receiver);
                    t[1][run] += middle - start;
                    t[2][run] += bench_seconds() - middle;
                }
                t[3][run] = bench_seconds();
                for (i = 0; i < COUNT; ++i) sfem_receiver_step(receiver);
                t[3][run] = bench_seconds() - t[3][run];
                sfem_sender_free(sender);
                sfem_receiver_free(receiver);
            }
            printf("  %5d %8s %6lu %6lu %8.0f %8.0f %8.0f %8.0f\n", s.m,
                   single ? "float" : "double", (unsigned long)p[1].bytes,
                   (unsigned long)p[0].bytes, bench_median(t[0], RUNS) / COUNT * 1e9,
                   bench_median(t[1], RUNS) / COUNT * 1e9, bench_median(t[2], RUNS) / COUNT * 1e9,
                   bench_median(t[3], RUNS) / COUNT * 1e9);
        }
    }
}

int main(int argc, char **argv)
{
    const int quick = argc > 1 && !strcmp(argv[1], "--quick");
    printf("one thread\n%s\n", SFEM_BENCH_FLAGS);
    costs();
    table(1 / 60.0, quick ? 2000 : 40000);
    table(1 / 240.0, quick ? 2000 : 40000);
    return 0;
}
