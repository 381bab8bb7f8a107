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
 *     cc -O2 -I. examples/stream.c softfem.o -lm          (softfem.o: see README)
 *
 * stream-time.svg shows the distortion against time, stream-loss.svg against the rate of loss,
 * stream.png the true body in grey and the received ones, coloured by the distance between. The last
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
    sfem_model *model;
    sfem_modes modes;
    double mass;
    double *push[2];   /* [m] Phi^T f of a newton across the tip, along y and z */
    double *k, *c;     /* [m] */
    double *q, *v, *a; /* [m] */
    double h, hand[2], target[2];
    uint64_t random;
} body;

static body body_new(const ex_options *o)
{
    const sfem_real size[3] = {1, 0.1, 0.1};
    sfem_model_def def = sfem_default_model_def();
    sfem_modes_def modes_def = sfem_default_modes_def();
    sfem_int *pins, tip = 0, i, j;
    double cells[3];
    sfem_int n[3];
    sfem_error err;
    body b;
    int k;
    memset(&b, 0, sizeof b);
    ex_reals(o, "--cells", 3, cells);
    for (k = 0; k < 3; ++k) n[k] = (sfem_int)cells[k];
    must(sfem_mesh_block(n, size, SFEM_CELL_5_TETS, NULL, &b.mesh, &err), &err);
    must(sfem_mesh_surface(&b.mesh, NULL, &b.surface, &err), &err);
    def.mesh = &b.mesh;
    def.material.young = ex_real(o, "--young");
    must(sfem_model_create(&def, &b.model, &err), &err);
    b.mass = sfem_model_total_mass(b.model);
    pins = (sfem_int *)ex_new((size_t)b.mesh.nodes, sizeof *pins);
    for (i = 0; i < b.mesh.nodes; ++i) {
        if (b.mesh.x[3 * i] < 1e-9) pins[modes_def.pin_count++] = i;
        tip += b.mesh.x[3 * i] > 1 - 1e-9;
    }
    modes_def.pins = pins;
    modes_def.modes = (sfem_int)ex_integer(o, "--modes");
    must(sfem_modes_create(b.model, &modes_def, &b.modes, &err), &err);
    free(pins);
    b.k = (double *)ex_new((size_t)b.modes.count, 7 * sizeof *b.k);
    b.c = b.k + b.modes.count;
    b.q = b.c + b.modes.count;
    b.v = b.q + b.modes.count;
    b.a = b.v + b.modes.count;
    for (k = 0; k < 2; ++k) b.push[k] = b.a + (k + 1) * b.modes.count;
    for (j = 0; j < b.modes.count; ++j) {
        const double *phi = b.modes.phi + (size_t)j * 3 * (size_t)b.mesh.nodes;
        b.k[j] = b.modes.lambda[j];
        b.c[j] = 2 * 0.02 * sqrt(b.k[j]);
        for (i = 0; i < b.mesh.nodes; ++i)
            for (k = 0; k < 2 && b.mesh.x[3 * i] > 1 - 1e-9; ++k)
                b.push[k][j] += phi[3 * i + k + 1] / tip;
    }
    b.h = ex_real(o, "--dt");
    b.random = 5;
    return b;
}

static void body_free(body *b)
{
    free(b->k);
    sfem_modes_free(&b->modes);
    sfem_model_free(b->model);
    sfem_surface_free(&b->surface);
    sfem_mesh_free(&b->mesh);
}

static void body_rest(body *b)
{
    memset(b->q, 0, 3 * (size_t)b->modes.count * sizeof *b->q); /* v and a as well */
    memset(b->hand, 0, sizeof b->hand);
    memset(b->target, 0, sizeof b->target);
    b->random = 5;
}

/* Average acceleration [A.7-A.11]; the hand comes slowly and goes at once. */
static void body_step(body *b)
{
    const double h = b->h, newton = 0.6 * 4e5 / 4e5;
    int j, k;
    if (uniform(&b->random) < h / 0.7) {
        const int off = uniform(&b->random) < 0.4;
        for (k = 0; k < 2; ++k) b->target[k] = off ? 0 : newton * (2 * uniform(&b->random) - 1);
    }
    for (k = 0; k < 2; ++k)
        b->hand[k] += (b->target[k] - b->hand[k]) * (b->target[k] != 0 ? 1 - exp(-h / 0.1) : 1);
    for (j = 0; j < b->modes.count; ++j) {
        const double q = b->q[j] + h * b->v[j] + h * h / 4 * b->a[j], v = b->v[j] + h / 2 * b->a[j];
        const double load = b->push[0][j] * b->hand[0] + b->push[1][j] * b->hand[1];
        b->a[j] = (load - b->c[j] * v - b->k[j] * q) / (1 + h / 2 * b->c[j] + h * h / 4 * b->k[j]);
        b->q[j] = q + h * h / 4 * b->a[j];
        b->v[j] = v + h / 2 * b->a[j];
    }
}

/* where the nodes are */
static double *body_positions(const body *b, const double *q)
{
    const size_t n = 3 * (size_t)b->mesh.nodes;
    double *x = (double *)ex_new(n, sizeof *x);
    size_t i;
    int j;
    memcpy(x, b->mesh.x, n * sizeof *x);
    for (j = 0; j < b->modes.count; ++j)
        for (i = 0; i < n; ++i) x[i] += b->modes.phi[(size_t)j * n + i] * q[j];
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
    double *q, *received;     /* [m] when the distance was largest, or at the step asked for */
    double worst;
    sfem_receiver_info info;
} run;

static sfem_link_def link_def(const ex_options *o, const body *b, int way)
{
    sfem_link_def d = sfem_default_link_def();
    d.modes = b->modes.count;
    d.h = b->h;
    d.key_every = way == 4 ? 0 : (sfem_int)ex_integer(o, "--key");
    d.single = !ex_given(o, "--double");
    d.lost = (sfem_lost)(way % 4);
    d.stiffness = b->k;
    d.damping = b->c;
    return d;
}

static void go(const ex_options *o, body *b, wire *w, int way, double percent, long steps, run *r)
{
    static unsigned char packet[PACKET];
    const sfem_link_def def = link_def(o, b, way);
    const size_t m = (size_t)b->modes.count;
    uint64_t losses = (uint64_t)ex_integer(o, "--seed");
    double off = 0, all = 0;
    sfem_sender *sender;
    sfem_receiver *receiver;
    sfem_error err;
    size_t j;
    long i;
    must(sfem_sender_create(&def, &sender, &err), &err);
    must(sfem_receiver_create(&def, &receiver, &err), &err);
    body_rest(b);
    for (i = 0; i <= steps; ++i) {
        const double *q = sfem_receiver_displacement(receiver);
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
            here += (q[j] - b->q[j]) * (q[j] - b->q[j]) / b->mass;
            all += b->q[j] * b->q[j] / b->mass;
        }
        off += here;
        if (!r->distance) continue;
        r->distance[i] = sqrt(here);
        if (here < r->worst) continue;
        r->worst = here;
        memcpy(r->q, b->q, m * sizeof *q);
        memcpy(r->received, q, m * sizeof *q);
    }
    r->distortion = sqrt(off / all);
    r->info = sfem_receiver_get_info(receiver);
    sfem_sender_free(sender);
    sfem_receiver_free(receiver);
}

/* --------------------------------------------------------------------------------------------
 * 4. plots and a picture
 * -------------------------------------------------------------------------------------------- */

static void plot_time(const ex_options *o, run *r, double h, long steps, const char *title)
{
    ex_plot p = ex_plot_new(title, "t, s", "distance of received from true, m", EX_LOG_Y);
    double *t = (double *)ex_new((size_t)steps + 1, sizeof *t);
    long i;
    int way;
    for (i = 0; i <= steps; ++i) t[i] = h * (double)i;
    for (way = 0; way < WAYS; ++way)
        ex_plot_add(&p, way_label[way], t, r[way].distance, steps + 1, EX_LINE);
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

static void draw(const ex_options *o, const body *b, const run *r)
{
    static const double direction[3] = {-0.45, 1, -0.3};
    ex_picture *p = ex_picture_new(1500, 900);
    ex_style style = ex_default_style();
    double lower[3], upper[3], *x[2][4], *distance[4];
    const long nodes = b->mesh.nodes;
    char caption[96];
    long i;
    int way, k;
    p->bar = 1;
    p->ground = NAN;
    style.high = 0;
    for (way = 0; way < 4; ++way) {
        distance[way] = (double *)ex_new((size_t)nodes, sizeof **distance);
        x[0][way] = body_positions(b, r[way].q);
        x[1][way] = body_positions(b, r[way].received);
        for (k = 0; k < 2; ++k) ex_bounds(x[k][way], nodes, way == 0 && k == 0, lower, upper);
        for (i = 0; i < nodes; ++i) {
            const double *a = x[0][way] + 3 * i, *c = x[1][way] + 3 * i;
            distance[way][i] = sqrt((a[0] - c[0]) * (a[0] - c[0]) + (a[1] - c[1]) * (a[1] - c[1]) +
                                    (a[2] - c[2]) * (a[2] - c[2]));
            style.high = fmax(style.high, distance[way][i]);
        }
    }
    for (way = 0; way < 4; ++way) {
        ex_style grey = ex_default_style();
        for (k = 0; k < 3; ++k) grey.color[k] = 0.78;
        ex_view_begin(p, way, 2, 2, lower, upper, direction);
        ex_view_surface(p, nodes, x[0][way], b->surface.triangles, b->surface.tri, NULL, &grey);
        ex_view_surface(p, nodes, x[1][way], b->surface.triangles, b->surface.tri, distance[way],
                        &style);
        snprintf(caption, sizeof caption, "lost accelerations %s: at its worst", way_label[way]);
        ex_view_end(p, caption);
        free(distance[way]);
        for (k = 0; k < 2; ++k) free(x[k][way]);
    }
    ex_colorbar(p, "off by, m", 0, style.high);
    ex_picture_write(p, ex_path(ex_text(o, "--out"), "stream.png"));
    ex_picture_free(p);
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
    steps = (long)((ex_given(&o, "--quick") ? 4 : ex_real(&o, "--seconds")) / b.h + 0.5);
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
        r[way].q = (double *)ex_new((size_t)b.modes.count, 2 * sizeof(double));
        r[way].received = r[way].q + b.modes.count;
        go(&o, &b, &w, way, shown, steps, &r[way]);
    }
    ex_progress("streaming", 1, 1);
    snprintf(title, sizeof title, "%.0f %% of the packets lost, a key frame every %ld", shown,
             ex_integer(&o, "--key"));
    plot_time(&o, r, b.h, steps, title);
    plot_loss(&o, percent, distortion);
    draw(&o, &b, r);
    printf("wrote %s/stream-time.svg, stream-loss.svg, stream.png\n", ex_text(&o, "--out"));
    printf("transport %s\nmodes %d\nsteps %ld\n", w.udp ? "udp" : "memory", (int)b.modes.count,
           steps);
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
