/* stream - a body simulated here, seen there, over a link that loses packets.
 *
 *     sender                          UDP, 0 to 30 % lost              receiver
 *     q'' + c q' + k q = Phi^T f  --->  q'' of each step          --->  q, q' by Newmark from q''
 *                                 --->  q, q', q'' now and then   --->  where the sender is
 *
 * A clamped bar is pushed about by a hand that lets go at random. It moves in --modes modes, of which
 * the sender sends the accelerations; the receiver integrates what arrives, and takes for what does not
 * nothing (as the source does), the last, a line through the last two, or what the mode would do by
 * itself [softfem.h, >>api-link]. Both ends are in this program, but talk through real sockets where
 * there are any. Which packets are lost follows from --seed, so that every run is the same.
 *
 *     cc -O2 -c -DSOFTFEM_IMPLEMENTATION -x c softfem.h && cc -O2 -I. examples/stream.c softfem.o -lm
 *
 * stream-time.svg shows the distortion against time, stream-loss.svg against the rate of loss,
 * stream.png the received bodies, coloured by how far they are from the true one, whose edges are drawn
 * as lines, when the first of them is at its worst. The last
 * lines on stdout are `key value`: distortion_zero_20 is the root mean square distance of received from
 * true over time and mass, over that of the true body from rest, at 20 % loss.
 */
#include "support.h"
#include "softfem.h"

#if defined(__unix__) || defined(__APPLE__)
#define SOCKETS 1
#include <arpa/inet.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/socket.h>
#else
#define SOCKETS 0
#endif

enum { RATES = 7, WAYS = 5, PACKET = 65507 };

static const ex_option table[] = {
    {"--cells", "NX,NY,NZ", "12,2,2", "cells of the bar, five tets each"},
    {"--young", "E", "4e5", "Young's modulus, Pa"},
    {"--modes", "N", "20", "modes of the body"},
    {"--seconds", "T", "60", "how long each run lasts, in simulated time"},
    {"--dt", "H", "0.016666666666666666", "time step, s"},
    {"--key", "K", "30", "a key frame every K packets"},
    {"--loss", "PERCENT", "20", "of the plot against time and of the picture"},
    {"--double", NULL, NULL, "send doubles, not floats"},
    {"--memory", NULL, NULL, "without sockets"},
    {"--seed", "N", "1", "of the losses"},
    {"--out", "DIR", "build/stream", "where files go"},
    {"--quick", NULL, NULL, "a small run: four seconds"},
    {NULL, NULL, NULL, NULL}};

/* what the receiver does about losses; the last without key frames but the first */
static const char *const way_name[WAYS] = {"zero", "held", "extrapolated", "predicted",
                                           "zero_no_keys"};
static const char *const way_label[WAYS] = {"zero", "held", "extrapolated", "predicted",
                                            "zero, no key frames"};

static void must(sfem_status status, const sfem_error *err)
{
    if (status != SFEM_OK) ex_fail("%s", err->text);
}

static double uniform(uint64_t *state) /* splitmix64 [Steele, Lea, Flood 2014] */
{
    uint64_t z = (*state += 0x9e3779b97f4a7c15u);
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
    return (double)((z ^ (z >> 31)) >> 11) / 9007199254740992.0;
}

/* --------------------------------------------------------------------------------------------
 * 1. the body: a bar of 1 x 0.1 x 0.1 m, clamped at x = 0, in its lowest modes
 * -------------------------------------------------------------------------------------------- */

typedef struct body {
    sfem_mesh mesh;
    sfem_surface surface;
    sfem_reduced *reduced;
    sfem_reduced_view *view;
    sfem_modal *modal;           /* the sender's */
    sfem_modal *mirror;          /* the receiver's: to be drawn, never stepped */
    const double *q, *v, *a;     /* [modes] of the sender's */
    double *force;               /* [nodes][3] */
    double *stiffness, *damping; /* [modes] of the oscillators, for who predicts */
    double h, hand[2], goal[2];  /* N, across the tip: now, and where it tends to */
    sfem_int modes, tip;         /* nodes at the tip */
    uint64_t random;
} body;

static void body_reduce(body *b, const ex_options *o)
{
    sfem_model_def def = sfem_default_model_def();
    sfem_modes_def modes_def = sfem_default_modes_def();
    sfem_reduced_def reduced_def = sfem_default_reduced_def();
    sfem_int *pins = (sfem_int *)ex_new((size_t)b->mesh.nodes, sizeof *pins), i;
    double *ratio;
    sfem_model *model;
    sfem_modes modes;
    sfem_error err;
    def.mesh = &b->mesh;
    def.material.young = ex_real(o, "--young");
    must(sfem_model_create(&def, &model, &err), &err);
    for (i = 0; i < b->mesh.nodes; ++i)
        if (b->mesh.x[3 * i] < 1e-9) pins[modes_def.pin_count++] = i;
    modes_def.pins = pins;
    modes_def.modes = b->modes = (sfem_int)ex_integer(o, "--modes");
    must(sfem_modes_create(model, &modes_def, &modes, &err), &err);
    ratio = (double *)ex_new((size_t)modes.count, sizeof *ratio);
    for (i = 0; i < modes.count; ++i) ratio[i] = 0.02;
    reduced_def.ratio = ratio;
    reduced_def.free = 0;
    must(sfem_reduced_create(model, &modes, &reduced_def, &b->reduced, &err), &err);
    sfem_modes_free(&modes);
    sfem_model_free(model);
    free(ratio);
    free(pins);
}

static body body_new(const ex_options *o)
{
    const sfem_real size[3] = {1, 0.1, 0.1};
    const sfem_modal_def def = sfem_default_modal_def();
    double cells[3];
    sfem_int n[3], i;
    sfem_error err;
    body b;
    int k;
    memset(&b, 0, sizeof b);
    ex_reals(o, "--cells", 3, cells);
    for (k = 0; k < 3; ++k) n[k] = (sfem_int)cells[k];
    must(sfem_mesh_block(n, size, SFEM_CELL_5_TETS, NULL, &b.mesh, &err), &err);
    must(sfem_mesh_surface(&b.mesh, NULL, &b.surface, &err), &err);
    body_reduce(&b, o);
    must(sfem_reduced_view_create(b.reduced, b.mesh.nodes, NULL, SFEM_DOUBLE, &b.view, &err), &err);
    must(sfem_modal_create(b.reduced, &def, &b.modal, &err), &err);
    must(sfem_modal_create(b.reduced, &def, &b.mirror, &err), &err);
    b.q = sfem_modal_coordinates(b.modal);
    b.v = sfem_modal_coordinate_velocities(b.modal);
    b.a = sfem_modal_coordinate_accelerations(b.modal);
    b.force = (double *)ex_new(3 * (size_t)b.mesh.nodes, sizeof *b.force);
    for (i = 0; i < b.mesh.nodes; ++i) b.tip += b.mesh.x[3 * i] > 1 - 1e-9;
    b.h = ex_positive(o, "--dt");
    b.stiffness = (double *)ex_new(2 * (size_t)b.modes, sizeof *b.stiffness);
    b.damping = b.stiffness + b.modes;
    sfem_modal_oscillators(b.modal, b.h, b.stiffness, b.damping);
    return b;
}

static void body_free(body *b)
{
    free(b->force);
    free(b->stiffness);
    sfem_modal_free(b->modal);
    sfem_modal_free(b->mirror);
    sfem_reduced_view_free(b->view);
    sfem_reduced_free(b->reduced);
    sfem_surface_free(&b->surface);
    sfem_mesh_free(&b->mesh);
}

static void body_rest(body *b)
{
    double *zero = (double *)ex_new((size_t)b->modes, sizeof *zero);
    sfem_error err;
    must(sfem_modal_set_lasting_force(b->modal, NULL, &err), &err);
    must(sfem_modal_set_coordinates(b->modal, zero, zero, zero, &err), &err);
    memset(b->hand, 0, sizeof b->hand);
    memset(b->goal, 0, sizeof b->goal);
    b->random = 5;
    free(zero);
}

/* A step; the hand comes slowly and goes at once. */
static void body_step(body *b)
{
    const double strongest = 1.2;
    sfem_error err;
    sfem_int i;
    int k;
    if (uniform(&b->random) < b->h / 0.7) {
        const int off = uniform(&b->random) < 0.4;
        for (k = 0; k < 2; ++k) b->goal[k] = off ? 0 : strongest * (2 * uniform(&b->random) - 1);
    }
    for (k = 0; k < 2; ++k)
        b->hand[k] += (b->goal[k] - b->hand[k]) * (b->goal[k] != 0 ? 1 - exp(-b->h / 0.1) : 1);
    for (i = 0; i < b->mesh.nodes; ++i)
        for (k = 0; k < 2 && b->mesh.x[3 * i] > 1 - 1e-9; ++k)
            b->force[3 * i + 1 + k] = b->hand[k] / b->tip;
    must(sfem_modal_set_lasting_force(b->modal, b->force, &err), &err);
    must(sfem_modal_step(b->modal, b->h, &err), &err);
}

/* Where the nodes are, warped, as the receiver would draw them. To be freed. */
static double *body_positions(const body *b, const double *q)
{
    double *x = (double *)ex_new(3 * (size_t)b->mesh.nodes, sizeof *x);
    sfem_error err;
    must(sfem_modal_set_coordinates(b->mirror, q, NULL, NULL, &err), &err);
    sfem_modal_positions(b->mirror, b->view, x);
    return x;
}

/* --------------------------------------------------------------------------------------------
 * 2. the wire: a UDP socket on loopback, or one packet's room in memory
 * -------------------------------------------------------------------------------------------- */

typedef struct wire {
    int udp, in, out;
    long sent, missing; /* missing: what the sockets lost, unasked */
    unsigned char held[PACKET];
    size_t held_bytes;
} wire;

static int wire_open(wire *w)
{
#if SOCKETS
    struct sockaddr_in here;
    socklen_t length = sizeof here;
    w->in = socket(AF_INET, SOCK_DGRAM, 0);
    w->out = socket(AF_INET, SOCK_DGRAM, 0);
    memset(&here, 0, sizeof here);
    here.sin_family = AF_INET;
    here.sin_addr.s_addr = htonl(INADDR_LOOPBACK); /* port 0: any that is free */
    w->udp = w->in >= 0 && w->out >= 0 && !bind(w->in, (struct sockaddr *)&here, sizeof here) &&
             !getsockname(w->in, (struct sockaddr *)&here, &length) &&
             !connect(w->out, (struct sockaddr *)&here, sizeof here);
    if (!w->udp && w->in >= 0) close(w->in);
    if (!w->udp && w->out >= 0) close(w->out);
#endif
    return w->udp;
}

static void wire_close(wire *w)
{
#if SOCKETS
    if (!w->udp) return;
    close(w->in);
    close(w->out);
#else
    (void)w;
#endif
}

static void wire_send(wire *w, const unsigned char *packet, size_t bytes)
{
    ++w->sent;
    w->held_bytes = bytes;
    if (!w->udp) memcpy(w->held, packet, bytes);
#if SOCKETS
    else if (send(w->out, packet, bytes, 0) != (ssize_t)bytes)
        ex_fail("send: %s", strerror(errno));
#endif
}

/* Bytes of the packet that has been sent, in w->held; 0 if there is none. */
static size_t wire_receive(wire *w)
{
    size_t bytes = w->held_bytes;
    w->held_bytes = 0;
#if SOCKETS
    if (w->udp && bytes) {
        struct pollfd p;
        ssize_t got = -1;
        p.fd = w->in;
        p.events = POLLIN;
        if (poll(&p, 1, 200) == 1) got = recv(w->in, w->held, sizeof w->held, 0);
        if (got < 0) ++w->missing;
        bytes = got < 0 ? 0 : (size_t)got;
    }
#endif
    return bytes;
}

/* --------------------------------------------------------------------------------------------
 * 3. a run: one rate of loss, one way of dealing with it
 * -------------------------------------------------------------------------------------------- */

typedef struct run {
    double distortion, bytes; /* bytes a step */
    double *distance;         /* [steps] root mean square over the mass, m; or NULL */
    double *q, *received;     /* [m] in step `moment`; < 0: when the distance is largest */
    double worst;
    long moment;
    sfem_receiver_info info;
} run;

static sfem_link_def link_def(const ex_options *o, const body *b, int way)
{
    sfem_link_def d = sfem_default_link_def();
    d.modes = b->modes;
    d.h = b->h; /* beta and gamma are those of a modal body by default */
    d.key_every = way == 4 ? 0 : (sfem_int)ex_integer(o, "--key");
    d.precision = !ex_given(o, "--double") ? SFEM_MIXED : SFEM_DOUBLE;
    d.lost = (sfem_lost)(way % 4);
    d.stiffness = b->stiffness;
    d.damping = b->damping;
    return d;
}

static void go(const ex_options *o, body *b, wire *w, int way, double percent, long steps, run *r)
{
    static unsigned char packet[PACKET];
    const sfem_link_def def = link_def(o, b, way);
    const size_t m = (size_t)b->modes;
    uint64_t losses = (uint64_t)ex_integer(o, "--seed");
    const double mass = sfem_reduced_get_info(b->reduced).mass;
    double off = 0, all = 0;
    sfem_sender *sender;
    sfem_receiver *receiver;
    sfem_error err;
    size_t j;
    long i, worst = 0;
    must(sfem_sender_create(&def, &sender, &err), &err);
    must(sfem_receiver_create(&def, &receiver, &err), &err);
    body_rest(b);
    for (i = 0; i <= steps; ++i) {
        const double *q = sfem_receiver_coordinates(receiver);
        double here = 0;
        size_t bytes;
        if (i) body_step(b);
        must(sfem_sender_write(sender, b->q, b->v, b->a, packet, sizeof packet, &bytes, &err),
             &err);
        r->bytes += (double)bytes / (double)(steps + 1);
        if (!i || 100 * uniform(&losses) >= percent) wire_send(w, packet, bytes);
        while ((bytes = wire_receive(w)) > 0) sfem_receiver_read(receiver, w->held, bytes);
        if (i) sfem_receiver_step(receiver);
        for (j = 0; j < m; ++j) {
            here += (q[j] - b->q[j]) * (q[j] - b->q[j]) / mass;
            all += b->q[j] * b->q[j] / mass;
        }
        off += here;
        if (!r->distance) continue;
        r->distance[i] = sqrt(here);
        if (r->moment >= 0 ? i != r->moment : here <= r->worst) continue;
        if (r->moment < 0) worst = i;
        r->worst = here;
        memcpy(r->q, b->q, m * sizeof *q);
        memcpy(r->received, q, m * sizeof *q);
    }
    r->distortion = sqrt(off / all);
    if (r->moment < 0) r->moment = worst;
    r->info = sfem_receiver_get_info(receiver);
    sfem_sender_free(sender);
    sfem_receiver_free(receiver);
}

/* --------------------------------------------------------------------------------------------
 * 4. plots and a picture
 * -------------------------------------------------------------------------------------------- */

/* the largest distance within each half second */
static void plot_time(const ex_options *o, const run *r, double h, long steps, const char *title)
{
    ex_plot p =
        ex_plot_new(title, "t, s", "received from true, m, at most in half a second", EX_LOG_Y);
    const long every = h < 0.5 ? (long)(0.5 / h) : 1, count = steps / every;
    double *t = (double *)ex_new((size_t)count, (WAYS + 1) * sizeof *t), *y;
    long i, k;
    int way;
    for (i = 0; i < count; ++i) t[i] = h * (double)((i + 1) * every);
    for (way = 0; way < WAYS; ++way) {
        y = t + (way + 1) * count;
        for (i = 0; i < count; ++i)
            for (k = 0; k < every; ++k) y[i] = fmax(y[i], r[way].distance[i * every + k]);
        for (i = 0; i < count; ++i) y[i] = fmax(y[i], 1e-7);
        ex_plot_add(&p, way_label[way], t, y, count, EX_LINE);
    }
    ex_plot_write(&p, ex_path(ex_text(o, "--out"), "stream-time.svg"));
    free(t);
}

static void plot_loss(const ex_options *o, const double *percent, double (*distortion)[RATES])
{
    ex_plot p =
        ex_plot_new("What losses do", "packets lost, %", "distortion over motion", EX_LOG_Y);
    int way;
    for (way = 0; way < WAYS; ++way)
        ex_plot_add(&p, way_label[way], percent, distortion[way], RATES, EX_LINE | EX_MARKERS);
    ex_plot_write(&p, ex_path(ex_text(o, "--out"), "stream-loss.svg"));
}

/* the four long edges of the bar at x */
static void draw_edges(ex_picture *p, const body *b, const double *x)
{
    static const double ink[3] = {0.85, 0.2, 0.1};
    sfem_int i, j;
    for (i = 0; i < b->mesh.nodes; ++i) {
        const double *at = b->mesh.x + 3 * i;
        sfem_int next = -1;
        if (fabs(at[1] - 0.05) < 0.049 || fabs(at[2] - 0.05) < 0.049) continue;
        for (j = 0; j < b->mesh.nodes; ++j) { /* the node behind it on the same edge */
            const double *to = b->mesh.x + 3 * j;
            if (to[0] > at[0] + 1e-9 && fabs(to[1] - at[1]) + fabs(to[2] - at[2]) < 1e-9 &&
                (next < 0 || to[0] < b->mesh.x[3 * next]))
                next = j;
        }
        if (next >= 0) ex_view_line(p, x + 3 * i, x + 3 * next, 2.5, ink);
    }
}

static void draw(const ex_options *o, const body *b, const run *r)
{
    static const double direction[3] = {-0.25, 1, -0.35};
    ex_picture *p = ex_picture_new(1500, 1000);
    ex_style style = ex_default_style();
    double lower[3], upper[3], *x[4], *distance[4], *truth = body_positions(b, r[0].q);
    const long nodes = b->mesh.nodes;
    char caption[96];
    long i;
    int way;
    p->bar = 1;
    p->ground = NAN;
    style.high = 0;
    ex_bounds(truth, nodes, 1, lower, upper);
    for (way = 0; way < 4; ++way) {
        distance[way] = (double *)ex_new((size_t)nodes, sizeof **distance);
        x[way] = body_positions(b, r[way].received);
        ex_bounds(x[way], nodes, 0, lower, upper);
        for (i = 0; i < nodes; ++i) {
            const double *a = truth + 3 * i, *c = x[way] + 3 * i;
            distance[way][i] = sqrt((a[0] - c[0]) * (a[0] - c[0]) + (a[1] - c[1]) * (a[1] - c[1]) +
                                    (a[2] - c[2]) * (a[2] - c[2]));
            style.high = fmax(style.high, distance[way][i]);
        }
    }
    for (way = 0; way < 4; ++way) {
        ex_view_begin(p, way, 2, 2, lower, upper, direction);
        ex_view_surface(p, nodes, x[way], b->surface.triangles, b->surface.tri, distance[way],
                        &style);
        draw_edges(p, b, truth);
        snprintf(caption, sizeof caption, "lost accelerations are %s", way_label[way]);
        ex_view_end(p, caption);
        free(distance[way]);
        free(x[way]);
    }
    ex_colorbar(p, "off by, m", 0, style.high);
    ex_picture_write(p, ex_path(ex_text(o, "--out"), "stream.png"));
    ex_picture_free(p);
    free(truth);
}

int main(int argc, char **argv)
{
    static wire w;
    static const double percent[RATES] = {0, 5, 10, 15, 20, 25, 30};
    const ex_options o =
        ex_parse(argc, argv, "Streams a modal body over a link with losses.", table);
    double distortion[WAYS][RATES], shown;
    run r[WAYS], one;
    body b;
    char title[96];
    long steps;
    int way, rate;
    ex_make_directory(ex_text(&o, "--out"));
    b = body_new(&o);
    shown = ex_real(&o, "--loss");
    if (!(shown >= 0 && shown <= 100))
        ex_fail("--loss: '%s' is not between 0 and 100", ex_text(&o, "--loss"));
    steps = ex_steps(ex_given(&o, "--quick") ? 4 : ex_positive(&o, "--seconds"), b.h);
    if (ex_given(&o, "--memory") || !wire_open(&w))
        printf("no sockets: packets go through memory\n");
    memset(r, 0, sizeof r);
    for (way = 0; way < WAYS; ++way) {
        for (rate = 0; rate < RATES; ++rate) {
            memset(&one, 0, sizeof one);
            ex_progress("streaming", way * (RATES + 1) + rate, WAYS * (RATES + 1));
            go(&o, &b, &w, way, percent[rate], steps, &one);
            distortion[way][rate] = one.distortion;
        }
        r[way].distance = (double *)ex_new((size_t)steps + 1, sizeof(double));
        r[way].q = (double *)ex_new((size_t)b.modes, 2 * sizeof(double));
        r[way].received = r[way].q + b.modes;
        r[way].moment = way ? r[0].moment : -1;
        go(&o, &b, &w, way, shown, steps, &r[way]);
    }
    ex_progress("streaming", 1, 1);
    snprintf(title, sizeof title, "%.0f %% of the packets lost, a key frame every %ld", shown,
             ex_integer(&o, "--key"));
    plot_time(&o, r, b.h, steps, title);
    plot_loss(&o, percent, distortion);
    draw(&o, &b, r);
    printf("wrote %s/stream-time.svg, stream-loss.svg, stream.png\n", ex_text(&o, "--out"));
    printf("transport %s\nmodes %d\nsteps %ld\n", w.udp ? "udp" : "memory", (int)b.modes, steps);
    printf("bytes_per_step %.1f\nbits_per_second %.0f\n", r[0].bytes, 8 * r[0].bytes / b.h);
    printf("packets_sent %ld\npackets_missing %ld\n", w.sent, w.missing);
    printf("lost_at_%.0f %ld\n", shown, (long)r[0].info.lost);
    for (way = 0; way < WAYS; ++way)
        for (rate = 0; rate < RATES; ++rate)
            printf("distortion_%s_%.0f %.3g\n", way_name[way], percent[rate],
                   distortion[way][rate]);
    for (way = 0; way < WAYS; ++way) {
        free(r[way].distance);
        free(r[way].q);
    }
    wire_close(&w);
    body_free(&b);
    return 0;
}
