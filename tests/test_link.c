/* The link: packets byte by byte, the theorem on lost accelerations, what comes late, twice, damaged
 * or not at all. */
#include "support.h"
#include "linear.h"

enum { M = 7, STEPS = 200, PACKET = 32 + 3 * 8 * 16 };

/* --------------------------------------------------------------------------------------------
 * a sender's motion: m oscillators under a load that changes, by Newmark's own formulas
 * -------------------------------------------------------------------------------------------- */

typedef struct motion {
    sfem_real h, beta, gamma, loads, rate, t;
    sfem_real k[M], c[M], q[M], v[M], a[M];
} motion;

static sfem_real load(const motion *s, int i)
{
    return s->loads * cos(s->rate * s->t + i) * (1 + i);
}

static motion motion_new(sfem_real beta, sfem_real gamma, sfem_real loads)
{
    motion s;
    int i;
    memset(&s, 0, sizeof s);
    s.h = 1 / 60.0;
    s.beta = beta;
    s.gamma = gamma;
    s.loads = loads;
    s.rate = 3;
    for (i = 0; i < M; ++i) {
        const sfem_real omega = 2 * TEST_PI * 1.3 * pow(1.8, i); /* omega h from .14 to 4.6 */
        s.k[i] = omega * omega;
        s.c[i] = 2 * 0.02 * omega;
        s.q[i] = 1.0 / (1 + i);
        s.v[i] = 0.3 * i;
        s.a[i] = load(&s, i) - s.k[i] * s.q[i] - s.c[i] * s.v[i];
    }
    return s;
}

static void motion_step(motion *s)
{
    const sfem_real h = s->h;
    int i;
    s->t += h;
    for (i = 0; i < M; ++i) {
        const sfem_real q = s->q[i] + h * s->v[i] + h * h / 2 * (1 - 2 * s->beta) * s->a[i];
        const sfem_real v = s->v[i] + (1 - s->gamma) * h * s->a[i];
        s->a[i] = (load(s, i) - s->c[i] * v - s->k[i] * q) /
                  (1 + s->gamma * h * s->c[i] + s->beta * h * h * s->k[i]);
        s->q[i] = q + s->beta * h * h * s->a[i];
        s->v[i] = v + s->gamma * h * s->a[i];
    }
}

/* --------------------------------------------------------------------------------------------
 * both ends
 * -------------------------------------------------------------------------------------------- */

typedef struct packet {
    unsigned char byte[PACKET];
    size_t bytes;
} packet;

static sfem_link_def link_def(sfem_int key_every)
{
    sfem_link_def d = sfem_default_link_def();
    d.modes = M;
    d.key_every = key_every;
    d.stream = 0xa1b2c3d4u;
    return d;
}

static sfem_sender *sender_new(const sfem_link_def *d)
{
    sfem_sender *s = NULL;
    sfem_error err;
    assert_ok(sfem_sender_create(d, &s, &err), err);
    return s;
}

static sfem_receiver *receiver_new(const sfem_link_def *d)
{
    sfem_receiver *r = NULL;
    sfem_error err;
    assert_ok(sfem_receiver_create(d, &r, &err), err);
    return r;
}

static packet send_state(sfem_sender *s, const sfem_real *q, const sfem_real *v, const sfem_real *a)
{
    packet p;
    sfem_error err;
    memset(&p, 0xee, sizeof p);
    assert_ok(sfem_sender_write(s, q, v, a, p.byte, sizeof p.byte, &p.bytes, &err), err);
    assert_in_range(p.bytes, 32, sizeof p.byte);
    return p;
}

static packet send(sfem_sender *s, const motion *x) { return send_state(s, x->q, x->v, x->a); }

/* The bytes in a block of exactly that size: the sanitizer sees any read beyond. */
static sfem_arrival receive_bytes(sfem_receiver *r, const unsigned char *bytes, size_t count)
{
    unsigned char *exact = (unsigned char *)malloc(count ? count : 1);
    sfem_arrival arrival;
    assert_non_null(exact);
    memcpy(exact, bytes, count);
    arrival = sfem_receiver_read(r, exact, count);
    free(exact);
    return arrival;
}

static sfem_arrival receive(sfem_receiver *r, const packet *p)
{
    return receive_bytes(r, p->byte, p->bytes);
}

static uint64_t state_hash(const sfem_receiver *r)
{
    return hash_reals(sfem_receiver_coordinates(r), M) * 3 +
           hash_reals(sfem_receiver_coordinate_velocities(r), M) * 5 +
           hash_reals(sfem_receiver_coordinate_accelerations(r), M) * 7;
}

static uint64_t motion_hash(const motion *s)
{
    return hash_reals(s->q, M) * 3 + hash_reals(s->v, M) * 5 + hash_reals(s->a, M) * 7;
}

static void assert_finite_state(const sfem_receiver *r)
{
    int i;
    for (i = 0; i < M; ++i) {
        assert_true(isfinite(sfem_receiver_coordinates(r)[i]));
        assert_true(isfinite(sfem_receiver_coordinate_velocities(r)[i]));
        assert_true(isfinite(sfem_receiver_coordinate_accelerations(r)[i]));
    }
}

/* rounding of some hundred steps, relative to the largest mode */
#define assert_follows(r, s)                                                                       \
    do {                                                                                           \
        assert_all_near(sfem_receiver_coordinates(r), (s)->q, M, 1e-13, 0);                       \
        assert_all_near(sfem_receiver_coordinate_velocities(r), (s)->v, M, 1e-13, 0);                           \
        assert_all_near(sfem_receiver_coordinate_accelerations(r), (s)->a, M, 1e-13, 0);                       \
    } while (0)

/* The packets of a run, the one of the initial state first, and the states they belong to. */
typedef struct recording {
    packet packet[STEPS + 1];
    motion state[STEPS + 1];
} recording;

static recording *record(const sfem_link_def *d, motion s)
{
    recording *x = (recording *)calloc(1, sizeof *x);
    sfem_sender *sender = sender_new(d);
    int i;
    assert_non_null(x);
    for (i = 0; i <= STEPS; ++i) {
        x->state[i] = s;
        x->packet[i] = send(sender, &s);
        motion_step(&s);
    }
    sfem_sender_free(sender);
    return x;
}

/* --------------------------------------------------------------------------------------------
 * the theorem
 * -------------------------------------------------------------------------------------------- */

static void without_loss_the_receiver_follows(void **state)
{
    const sfem_link_def d = link_def(0);
    sfem_receiver *r = receiver_new(&d);
    recording *x = record(&d, motion_new(0.25, 0.5, 10));
    int i;
    (void)state;
    assert_int_equal(receive(r, &x->packet[0]), SFEM_ARRIVAL_TAKEN);
    assert_int_equal(state_hash(r), motion_hash(&x->state[0]));
    assert_int_equal(sfem_receiver_lead(r), 0);
    for (i = 1; i <= STEPS; ++i) {
        assert_int_equal(receive(r, &x->packet[i]), SFEM_ARRIVAL_TAKEN);
        assert_int_equal(sfem_receiver_lead(r), 1);
        assert_int_equal(sfem_receiver_step(r), 1);
        assert_follows(r, &x->state[i]);
    }
    sfem_receiver_free(r);
    free(x);
}

/* received minus true, for one acceleration set to zero; numbers with few bits, so that all is exact */
static void one_lost_acceleration_distorts_as_the_theorem_says(void **state)
{
    enum { LOST = 5, AFTER = 40 };
    const sfem_real h = 1 / 64.0;
    sfem_link_def d = sfem_default_link_def();
    sfem_sender *s;
    sfem_receiver *whole, *holed;
    test_random random = {3};
    sfem_real a[M], lost[M] = {0}, zero[M] = {0};
    int i, step;
    (void)state;
    d.modes = M;
    d.h = h;
    d.key_every = 0;
    s = sender_new(&d);
    whole = receiver_new(&d);
    holed = receiver_new(&d);
    for (step = 0; step <= LOST + AFTER; ++step) {
        packet p;
        for (i = 0; i < M; ++i) a[i] = random_below(&random, 2001) - 1000;
        p = send_state(s, zero, zero, a);
        receive(whole, &p);
        if (step == LOST)
            memcpy(lost, a, sizeof lost);
        else
            receive(holed, &p);
        if (!step) continue;
        assert_int_equal(sfem_receiver_step(whole), 1);
        assert_int_equal(sfem_receiver_step(holed), step != LOST);
        for (i = 0; i < M; ++i) {
            const sfem_real dq =
                sfem_receiver_coordinates(holed)[i] - sfem_receiver_coordinates(whole)[i];
            const sfem_real dv =
                sfem_receiver_coordinate_velocities(holed)[i] - sfem_receiver_coordinate_velocities(whole)[i];
            const int k = step - LOST;
            assert_true(dv == (k < 0 ? 0 : k == 0 ? -0.5 : -1.0) * h * lost[i]);
            assert_true(dq == (k < 0 ? 0 : k == 0 ? -0.25 : -1.0 * k) * h * h * lost[i]);
        }
    }
    sfem_sender_free(s);
    sfem_receiver_free(whole);
    sfem_receiver_free(holed);
}

static void the_theorem_holds_for_a_real_motion(sfem_real beta, sfem_real gamma)
{
    enum { LOST = 17 };
    sfem_link_def d = link_def(0);
    sfem_receiver *r;
    recording *x;
    int i, step;
    d.beta = beta;
    d.gamma = gamma;
    r = receiver_new(&d);
    x = record(&d, motion_new(beta, gamma, 10));
    receive(r, &x->packet[0]);
    for (step = 1; step <= STEPS; ++step) {
        const motion *s = &x->state[step];
        const int k = step - LOST;
        if (step != LOST) receive(r, &x->packet[step]);
        sfem_receiver_step(r);
        for (i = 0; i < M; ++i) {
            const sfem_real ha = s->h * x->state[LOST].a[i];
            const sfem_real dv = k < 0 ? 0 : k == 0 ? -gamma * ha : -ha;
            const sfem_real dq = s->h * ha * (k < 0 ? 0 : k == 0 ? -beta : -(k - 0.5 + gamma));
            /* relative to the motion and to the distortion, which outgrows it */
            assert_near(sfem_receiver_coordinate_velocities(r)[i], s->v[i] + dv, 1e-13,
                        1e-13 * fabs(ha) + 1e-13);
            assert_near(sfem_receiver_coordinates(r)[i], s->q[i] + dq, 1e-13,
                        1e-13 * fabs(dq) + 1e-13);
        }
    }
    sfem_receiver_free(r);
    free(x);
}

static void the_theorem_holds_for_the_average_acceleration(void **state)
{
    (void)state;
    the_theorem_holds_for_a_real_motion(0.25, 0.5);
}

static void the_theorem_holds_for_other_newmark_methods(void **state)
{
    (void)state;
    the_theorem_holds_for_a_real_motion(0.3025, 0.6);
    the_theorem_holds_for_a_real_motion(1 / 6.0, 0.5);
}

/* --------------------------------------------------------------------------------------------
 * bytes
 * -------------------------------------------------------------------------------------------- */

static uint32_t crc32_by_bits(const unsigned char *p, size_t n)
{
    uint32_t c = 0xffffffffu;
    int k;
    for (; n; --n, ++p)
        for (c ^= *p, k = 0; k < 8; ++k) c = c & 1 ? c >> 1 ^ 0xedb88320u : c >> 1;
    return ~c;
}

static void put32(unsigned char *p, uint32_t x)
{
    int k;
    for (k = 0; k < 4; ++k) p[k] = (unsigned char)(x >> 8 * k & 255);
}

static void sign(packet *p) { put32(p->byte + 4, crc32_by_bits(p->byte + 8, p->bytes - 8)); }

static void a_packet_has_these_bytes(void **state)
{
    /* the checksums by Python's zlib.crc32 of what follows them */
    static const unsigned char key[56] = {
        'S',  'F',  'L',  'K',  0x68, 0x50, 0xcd, 0x0b, 1, 2, 8, 0, 4, 3, 2,    1,
        0xfe, 0xff, 0xff, 0xff, 1,    0,    0,    0,    0, 0, 0, 0, 0, 0, 0x90, 0x3f, /* h = 1/64 */
        0,    0,    0,    0,    0,    0,    0xf8, 0x3f,                               /* q = 1.5 */
        0,    0,    0,    0,    0,    0,    0,    0xc0,                               /* q' = -2 */
        0,    0,    0,    0,    0,    0,    0x09, 0x40}; /* q'' = 3.125 */
    static const unsigned char single[36] = {
        'S', 'F', 'L', 'K', 0x5d, 0x21, 0x25, 0xa8, 1, 1, 4,    0,
        4,   3,   2,   1,   0xff, 0xff, 0xff, 0xff, 1, 0, 0,    0,
        0,   0,   0,   0,   0,    0,    0x90, 0x3f, 0, 0, 0x48, 0xc0}; /* q'' = -3.125 */
    const sfem_real q = 1.5, v = -2, a = 3.125, b = -3.125;
    sfem_link_def d = sfem_default_link_def();
    sfem_sender *s;
    packet p;
    (void)state;
    d.modes = 1;
    d.h = 1 / 64.0;
    d.stream = 0x01020304u;
    d.first = 0xfffffffeu;
    s = sender_new(&d);
    assert_int_equal(sfem_sender_packet_size(s), sizeof key);
    p = send_state(s, &q, &v, &a);
    assert_int_equal(p.bytes, sizeof key);
    assert_memory_equal(p.byte, key, sizeof key);
    sfem_sender_free(s);
    d.precision = SFEM_MIXED;
    s = sender_new(&d);
    send_state(s, &q, &v, &a);
    p = send_state(s, NULL, NULL, &b);
    assert_int_equal(p.bytes, sizeof single);
    assert_memory_equal(p.byte, single, sizeof single);
    sfem_sender_free(s);
}

/* every value of every byte, every length, of accelerations and key frames */
static void every_damaged_packet_is_recognised(void **state)
{
    int single, what;
    size_t at, length;
    unsigned value;
    (void)state;
    for (single = 0; single < 2; ++single) {
        sfem_link_def d = link_def(2);
        sfem_receiver *r;
        recording *x;
        int64_t corrupted;
        d.precision = single ? SFEM_MIXED : SFEM_DOUBLE;
        r = receiver_new(&d);
        x = record(&d, motion_new(0.25, 0.5, 10));
        receive(r, &x->packet[0]);
        for (what = 1; what <= 2; ++what) {
            packet p = x->packet[what];
            const uint64_t before = state_hash(r);
            for (at = 0; at < p.bytes; ++at) {
                for (value = 1; value < 256; ++value) {
                    p.byte[at] = (unsigned char)(p.byte[at] ^ value);
                    assert_int_equal(receive(r, &p), SFEM_ARRIVAL_CORRUPTED);
                    p.byte[at] = (unsigned char)(p.byte[at] ^ value);
                }
            }
            for (length = 0; length < PACKET; ++length)
                if (length != p.bytes)
                    assert_int_equal(receive_bytes(r, p.byte, length), SFEM_ARRIVAL_CORRUPTED);
            corrupted = sfem_receiver_get_info(r).arrivals[SFEM_ARRIVAL_CORRUPTED];
            assert_int_equal(receive(r, &p), SFEM_ARRIVAL_TAKEN);
            assert_int_equal(sfem_receiver_get_info(r).arrivals[SFEM_ARRIVAL_CORRUPTED], corrupted);
            assert_int_equal(state_hash(r), before);
            sfem_receiver_step(r);
        }
        sfem_receiver_free(r);
        free(x);
    }
}

static void a_packet_of_another_link_is_foreign(void **state)
{
    const sfem_link_def d = link_def(0);
    sfem_receiver *r = receiver_new(&d);
    recording *x = record(&d, motion_new(0.25, 0.5, 10));
    static const struct {
        size_t at;
        unsigned char value;
    } change[] = {{8, 2}, {12, 1}, {20, M + 1}, {20, M - 1}, {23, 0x80}, {24, 1}, {31, 0xbf}};
    sfem_link_def other;
    packet p;
    size_t i;
    (void)state;
    receive(r, &x->packet[0]);
    for (i = 0; i < TEST_COUNT(change); ++i) {
        p = x->packet[1];
        p.byte[change[i].at] = change[i].value;
        sign(&p);
        assert_int_equal(receive(r, &p), SFEM_ARRIVAL_FOREIGN);
    }
    for (i = 0; i < 3; ++i) { /* the same by senders that were made so */
        const sfem_real big[M + 1] = {0};
        sfem_sender *s;
        other = d;
        if (i == 0) ++other.modes;
        if (i == 1) other.h *= 1 + 1e-15;
        if (i == 2) ++other.stream;
        s = sender_new(&other);
        p = send_state(s, big, big, big);
        assert_int_equal(receive(r, &p), SFEM_ARRIVAL_FOREIGN);
        sfem_sender_free(s);
    }
    assert_int_equal(state_hash(r), motion_hash(&x->state[0]));
    p = x->packet[1];
    sign(&p);
    assert_int_equal(receive(r, &p), SFEM_ARRIVAL_TAKEN);
    sfem_receiver_free(r);
    free(x);
}

static void sound_nonsense_is_corrupted(void **state)
{
    const sfem_link_def d = link_def(0);
    sfem_receiver *r = receiver_new(&d);
    recording *x = record(&d, motion_new(0.25, 0.5, 10));
    static const uint64_t not_finite[3] = {0x7ff0000000000000u, 0xfff0000000000000u,
                                           0x7ff8000000000001u};
    packet p;
    int i, k;
    (void)state;
    for (k = 0; k < 2; ++k) {
        for (i = 0; i < 3; ++i) {
            p = x->packet[k];
            put32(p.byte + p.bytes - 8, (uint32_t)(not_finite[i] & 0xffffffffu));
            put32(p.byte + p.bytes - 4, (uint32_t)(not_finite[i] >> 32));
            sign(&p);
            assert_int_equal(receive(r, &p), SFEM_ARRIVAL_CORRUPTED);
        }
        for (i = 0; i < 256; ++i) { /* kinds and number sizes that do not fit the length */
            p = x->packet[k];
            p.byte[9] = (unsigned char)i;
            sign(&p);
            if (i != (k ? 1 : 2)) assert_int_equal(receive(r, &p), SFEM_ARRIVAL_CORRUPTED);
            p = x->packet[k];
            p.byte[10] = (unsigned char)i;
            sign(&p);
            if (i != 8) assert_int_equal(receive(r, &p), SFEM_ARRIVAL_CORRUPTED);
        }
        assert_int_equal(receive(r, &x->packet[k]), SFEM_ARRIVAL_TAKEN);
    }
    sfem_receiver_free(r);
    free(x);
}

static void no_bytes_make_a_nan(void **state)
{
    test_random random = {11};
    int round, lost;
    (void)state;
    for (lost = SFEM_LOST_ZERO; lost <= SFEM_LOST_PREDICTED; ++lost) {
        const motion s = motion_new(0.25, 0.5, 10);
        sfem_link_def d = link_def(7);
        sfem_receiver *r;
        recording *x;
        d.lost = (sfem_lost)lost;
        d.window = 4;
        d.stiffness = s.k;
        d.damping = s.c;
        r = receiver_new(&d);
        x = record(&d, s);
        for (round = 0; round < 30000; ++round) {
            packet p = x->packet[random_below(&random, STEPS + 1)];
            int changes = random_below(&random, 6);
            while (changes--)
                p.byte[random_below(&random, (sfem_int)p.bytes)] =
                    (unsigned char)(random_bits(&random) & 255);
            if (random_below(&random, 8) == 0) p.bytes = (size_t)random_below(&random, PACKET);
            if (p.bytes >= 8 &&
                random_below(&random, 4)) { /* sound: the mad numbers come through */
                if (random_below(&random, 2)) p.byte[16 + random_below(&random, 2)] ^= 1;
                sign(&p);
            }
            if (random_below(&random, 16) == 0) {
                size_t i;
                for (i = 0; i < p.bytes; ++i)
                    p.byte[i] = (unsigned char)(random_bits(&random) & 255);
            }
            if (round % 300 == 0) { /* a mad sequence number makes all that follow look late */
                sfem_receiver_restart(r, d.stream);
                receive(r, &x->packet[0]);
            }
            assert_in_range(receive(r, &p), 0, SFEM_ARRIVAL_COUNT - 1);
            if (random_below(&random, 2)) sfem_receiver_step(r);
            assert_finite_state(r);
            assert_in_range(sfem_receiver_lead(r) + (int64_t)INT32_MAX, 0, 2 * (int64_t)INT32_MAX);
        }
        assert_true(sfem_receiver_get_info(r).steps > 5000);
        assert_true(sfem_receiver_get_info(r).arrivals[SFEM_ARRIVAL_TAKEN] > 100);
        sfem_receiver_free(r);
        free(x);
    }
}

static void numbers_that_overflow_stop_the_mode(void **state)
{
    int lost;
    (void)state;
    for (lost = SFEM_LOST_ZERO; lost <= SFEM_LOST_PREDICTED; ++lost) {
        const sfem_real huge[M] = {1.7e308, -1.7e308, 1e300, 0, 1, -1, 1.7e308};
        const sfem_real stiff[M] = {1e300, 1, 1, 1, 1, 1, 1e308};
        sfem_link_def d = link_def(4);
        sfem_sender *s;
        sfem_receiver *r;
        int i;
        d.h = 1e5;
        d.lost = (sfem_lost)lost;
        d.stiffness = stiff;
        s = sender_new(&d);
        r = receiver_new(&d);
        for (i = 0; i < 50; ++i) {
            const packet p = send_state(s, huge, huge, huge);
            if (i % 3) sfem_receiver_step(r);
            receive(r, &p);
            assert_finite_state(r);
        }
        assert_true(sfem_receiver_get_info(r).overflows > 0);
        sfem_sender_free(s);
        sfem_receiver_free(r);
    }
}

/* --------------------------------------------------------------------------------------------
 * order
 * -------------------------------------------------------------------------------------------- */

static void repeated_packets_change_nothing(void **state)
{
    const sfem_link_def d = link_def(5);
    sfem_receiver *once = receiver_new(&d), *thrice = receiver_new(&d);
    recording *x = record(&d, motion_new(0.25, 0.5, 10));
    int i, k;
    (void)state;
    for (i = 0; i <= STEPS; ++i) {
        receive(once, &x->packet[i]);
        receive(thrice, &x->packet[i]);
        assert_int_equal(receive(thrice, &x->packet[i]), SFEM_ARRIVAL_REPEATED);
        if (i) sfem_receiver_step(once), sfem_receiver_step(thrice);
        for (k = 0; k < 3 && k <= i; ++k)
            assert_int_equal(receive(thrice, &x->packet[i - k]), SFEM_ARRIVAL_REPEATED);
        assert_int_equal(state_hash(once), state_hash(thrice));
    }
    assert_int_equal(sfem_receiver_get_info(thrice).arrivals[SFEM_ARRIVAL_LATE], 0);
    sfem_receiver_free(once);
    sfem_receiver_free(thrice);
    free(x);
}

/* Shuffled within a delay of 8 steps that the receiver grants. */
static void reordered_packets_wait_for_their_step(void **state)
{
    enum { DELAY = 8 };
    const sfem_link_def d = link_def(13);
    sfem_receiver *r = receiver_new(&d), *straight = receiver_new(&d);
    recording *x = record(&d, motion_new(0.25, 0.5, 10));
    test_random random = {5};
    int order[STEPS + 1], i, k, step = 0;
    (void)state;
    for (i = 0; i <= STEPS; ++i) order[i] = i;
    for (i = 1; i + DELAY <= STEPS; i += DELAY)
        for (k = DELAY - 1; k > 0; --k) {
            const int j = random_below(&random, k + 1), t = order[i + j];
            order[i + j] = order[i + k];
            order[i + k] = t;
        }
    receive(straight, &x->packet[0]);
    for (i = 0; i <= STEPS; ++i) {
        assert_int_equal(receive(r, &x->packet[order[i]]), SFEM_ARRIVAL_TAKEN);
        while (sfem_receiver_lead(r) > DELAY) {
            ++step;
            receive(straight, &x->packet[step]);
            assert_int_equal(sfem_receiver_step(straight), 1);
            assert_int_equal(sfem_receiver_step(r), 1);
            assert_int_equal(state_hash(r), state_hash(straight));
        }
    }
    assert_int_equal(step, STEPS - DELAY);
    assert_int_equal(sfem_receiver_lead(r), DELAY);
    sfem_receiver_free(r);
    sfem_receiver_free(straight);
    free(x);
}

static void a_late_acceleration_is_put_right_exactly(void **state)
{
    static const sfem_real method[2][2] = {{0.25, 0.5}, {0.3025, 0.6}};
    int which, lost, late;
    (void)state;
    for (which = 0; which < 2; ++which) {
        for (lost = SFEM_LOST_ZERO; lost <= SFEM_LOST_PREDICTED; ++lost) {
            for (late = 0; late < 31; late += late < 4 ? 1 : 9) {
                motion s = motion_new(method[which][0], method[which][1], 10);
                sfem_link_def d = link_def(0);
                sfem_receiver *r;
                recording *x;
                int i;
                d.beta = s.beta;
                d.gamma = s.gamma;
                d.lost = (sfem_lost)lost;
                d.stiffness = s.k;
                d.damping = s.c;
                r = receiver_new(&d);
                x = record(&d, s);
                for (i = 0; i <= 40 + late; ++i) {
                    if (i != 40) receive(r, &x->packet[i]);
                    if (i) sfem_receiver_step(r);
                }
                assert_true(fabs(sfem_receiver_coordinate_velocities(r)[0] - x->state[40 + late].v[0]) > 1e-9);
                assert_int_equal(receive(r, &x->packet[40]), SFEM_ARRIVAL_LATE);
                assert_follows(r, &x->state[40 + late]);
                assert_int_equal(receive(r, &x->packet[40]), SFEM_ARRIVAL_REPEATED);
                assert_follows(r, &x->state[40 + late]);
                sfem_receiver_free(r);
                free(x);
            }
        }
    }
}

/* every packet late by up to 20 steps, in any order: in the end nothing is wrong */
static void a_run_of_late_packets_is_put_right(void **state)
{
    sfem_link_def d = link_def(0);
    sfem_receiver *r;
    recording *x = record(&d, motion_new(0.25, 0.5, 10));
    test_random random = {9};
    int due[STEPS + 1], i, k;
    sfem_real worst[M] = {0};
    (void)state;
    d.lost = SFEM_LOST_HELD;
    r = receiver_new(&d);
    for (i = 0; i <= STEPS; ++i) due[i] = i ? i + random_below(&random, 21) : 0;
    for (i = 0; i <= STEPS; ++i) {
        for (k = 0; k <= i; ++k)
            if (due[k] == i) receive(r, &x->packet[k]);
        if (i < STEPS) sfem_receiver_step(r);
        for (k = 0; k < M; ++k) worst[k] = fmax(worst[k], fabs(sfem_receiver_coordinates(r)[k]));
    }
    for (k = 0; k <= STEPS; ++k)
        if (due[k] > STEPS) assert_int_equal(receive(r, &x->packet[k]), SFEM_ARRIVAL_LATE);
    for (k = 0; k < M; ++k) { /* rounding is that of what it had gone to meanwhile */
        assert_near(sfem_receiver_coordinates(r)[k], x->state[STEPS].q[k], 0, 1e-13 * worst[k]);
        assert_near(sfem_receiver_coordinate_velocities(r)[k], x->state[STEPS].v[k], 0, 1e-13 * worst[k] * 60);
        assert_true(sfem_receiver_coordinate_accelerations(r)[k] == x->state[STEPS].a[k]);
    }
    assert_true(sfem_receiver_get_info(r).arrivals[SFEM_ARRIVAL_LATE] > STEPS / 2);
    sfem_receiver_free(r);
    free(x);
}

static void a_late_key_frame_is_the_same_as_one_in_time(void **state)
{
    sfem_link_def d = link_def(20);
    sfem_receiver *r, *punctual;
    recording *x = record(&d, motion_new(0.25, 0.5, 10));
    int i, late;
    (void)state;
    for (late = 0; late < 15; ++late) {
        r = receiver_new(&d);
        punctual = receiver_new(&d);
        for (i = 0; i <= 40 + late; ++i) {
            if (i % 7) receive(punctual, &x->packet[i]);
            if (i % 7 && i != 40) receive(r, &x->packet[i]);
            if (i == 0) receive(r, &x->packet[i]), receive(punctual, &x->packet[i]);
            if (i) sfem_receiver_step(r), sfem_receiver_step(punctual);
        }
        assert_int_not_equal(state_hash(r), state_hash(punctual));
        assert_int_equal(receive(r, &x->packet[40]), SFEM_ARRIVAL_LATE);
        assert_int_equal(sfem_receiver_get_info(r).late_keys, 1);
        assert_int_equal(state_hash(r), state_hash(punctual));
        /* what was lost before it is of no more use */
        assert_int_equal(receive(r, &x->packet[35]), SFEM_ARRIVAL_DROPPED);
        assert_int_equal(receive(r, &x->packet[35]), SFEM_ARRIVAL_REPEATED);
        assert_int_equal(state_hash(r), state_hash(punctual));
        sfem_receiver_free(r);
        sfem_receiver_free(punctual);
    }
    free(x);
}

static void what_comes_too_late_or_unwanted_is_dropped(void **state)
{
    int drop;
    (void)state;
    for (drop = 0; drop < 2; ++drop) {
        sfem_link_def d = link_def(0);
        sfem_receiver *r;
        recording *x = record(&d, motion_new(0.25, 0.5, 10));
        uint64_t before;
        int i;
        d.window = 10;
        d.keep_late = !drop;
        r = receiver_new(&d);
        receive(r, &x->packet[0]);
        for (i = 1; i <= 60; ++i) {
            if (i != 50 && i != 51) receive(r, &x->packet[i]);
            sfem_receiver_step(r);
        }
        before = state_hash(r);
        assert_int_equal(receive(r, &x->packet[50]), SFEM_ARRIVAL_DROPPED);
        assert_int_equal(state_hash(r), before);
        assert_int_equal(receive(r, &x->packet[51]),
                         drop ? SFEM_ARRIVAL_DROPPED : SFEM_ARRIVAL_LATE);
        assert_int_equal(state_hash(r) == before, drop);
        assert_int_equal(receive(r, &x->packet[70]), SFEM_ARRIVAL_TAKEN);
        assert_int_equal(receive(r, &x->packet[71]), SFEM_ARRIVAL_EARLY);
        sfem_receiver_free(r);
        free(x);
    }
}

/* --------------------------------------------------------------------------------------------
 * key frames
 * -------------------------------------------------------------------------------------------- */

static void a_key_frame_puts_the_receiver_where_the_sender_is(void **state)
{
    const sfem_link_def d = link_def(25);
    sfem_receiver *r = receiver_new(&d);
    recording *x = record(&d, motion_new(0.25, 0.5, 10));
    int i;
    (void)state;
    for (i = 0; i <= STEPS; ++i) {
        if (i % 25 == 0 || i % 3) receive(r, &x->packet[i]);
        if (i) sfem_receiver_step(r);
        if (i % 25 == 0) assert_int_equal(state_hash(r), motion_hash(&x->state[i]));
        if (i % 25 >= 3) assert_int_not_equal(state_hash(r), motion_hash(&x->state[i]));
    }
    assert_int_equal(sfem_receiver_get_info(r).keys, 1 + STEPS / 25);
    sfem_receiver_free(r);
    free(x);
}

static void key_frames_come_when_due_or_asked_for(void **state)
{
    static const sfem_int every[4] = {0, 1, 2, 30};
    const sfem_real zero[M] = {0};
    int k, i;
    (void)state;
    for (k = 0; k < 4; ++k) {
        const sfem_link_def d = link_def(every[k]);
        sfem_sender *s = sender_new(&d);
        int next = 0;
        for (i = 0; i < 100; ++i) {
            packet p;
            if (i == 41) {
                sfem_sender_request_key(s);
                next = i;
            }
            assert_int_equal(sfem_sender_key_due(s), i == next);
            p = send_state(s, i == next ? zero : NULL, i == next ? zero : NULL, zero);
            assert_int_equal(p.byte[9], i == next ? 2 : 1);
            assert_int_equal(p.bytes, 32 + (i == next ? 3 : 1) * 8 * M);
            if (i == next) next = every[k] ? i + every[k] : -1;
        }
        sfem_sender_free(s);
    }
}

static void before_the_first_key_frame_nothing_moves(void **state)
{
    const sfem_link_def d = link_def(50);
    const sfem_real zero[M] = {0};
    sfem_receiver *r = receiver_new(&d);
    recording *x = record(&d, motion_new(0.25, 0.5, 10));
    int i;
    (void)state;
    for (i = 10; i < 50; ++i) { /* joins in the middle */
        assert_int_equal(receive(r, &x->packet[i]), SFEM_ARRIVAL_EARLY);
        assert_int_equal(sfem_receiver_step(r), 0);
        assert_int_equal(sfem_receiver_lead(r), 0);
        assert_memory_equal(sfem_receiver_coordinates(r), zero, sizeof zero);
    }
    assert_int_equal(receive(r, &x->packet[50]), SFEM_ARRIVAL_TAKEN);
    assert_int_equal(state_hash(r), motion_hash(&x->state[50]));
    for (i = 51; i <= STEPS; ++i) {
        receive(r, &x->packet[i]);
        assert_int_equal(sfem_receiver_step(r), 1);
        assert_follows(r, &x->state[i]);
    }
    assert_int_equal(sfem_receiver_get_info(r).steps, STEPS - 50);
    sfem_receiver_free(r);
    free(x);
}

/* Steps 30 to 59 as with a handle held. Late and lost packets, the key frames of the changes among them;
 * in the end nothing is wrong. */
static void steps_of_two_methods_are_told_apart(void **state)
{
    int late;
    (void)state;
    for (late = 0; late < 26; ++late) {
        const sfem_link_def d = link_def(0);
        sfem_sender *sender = sender_new(&d);
        sfem_receiver *r = receiver_new(&d), *punctual = receiver_new(&d);
        motion s = motion_new(d.beta, d.gamma, 10);
        packet kept[4];
        int i, k;
        for (i = 0; i < 120; ++i) {
            const int held = i >= 30 && i < 60;
            packet p;
            s.beta = held ? d.held_beta : d.beta;
            s.gamma = held ? d.held_gamma : d.gamma;
            if (i) motion_step(&s);
            sfem_sender_set_held(sender, held);
            assert_int_equal(sfem_sender_key_due(sender), i == 0 || i == 30 || i == 60);
            p = send(sender, &s);
            assert_int_equal(p.byte[11], held);
            receive(punctual, &p);
            for (k = 0; k < 4; ++k) /* 29, 30, 31, 32 come late, the key frame among them */
                if (i == 29 + k) kept[k] = p;
            if (i < 29 || i > 32) receive(r, &p);
            if (i) sfem_receiver_step(r), sfem_receiver_step(punctual);
            assert_follows(punctual, &s);
            if (i == 33 + late) {
                int key_taken = 0;
                for (k = 0; k < 4; ++k) { /* in four orders; 29 is of no use once 30 has come */
                    const int which = (k + late) % 4;
                    assert_int_equal(receive(r, &kept[which]), which == 0 && key_taken
                                                                   ? SFEM_ARRIVAL_DROPPED
                                                                   : SFEM_ARRIVAL_LATE);
                    if (which == 1) key_taken = 1;
                }
            }
            if (i < 29 || i >= 33 + late) assert_follows(r, &s);
        }
        sfem_sender_free(sender);
        sfem_receiver_free(r);
        sfem_receiver_free(punctual);
    }
}

static void a_receiver_that_fell_behind_goes_on_at_a_key_frame(void **state)
{
    const sfem_link_def d = link_def(100);
    sfem_receiver *r = receiver_new(&d);
    recording *x = record(&d, motion_new(0.25, 0.5, 10));
    sfem_receiver_info info;
    (void)state;
    receive(r, &x->packet[0]);
    assert_int_equal(receive(r, &x->packet[98]), SFEM_ARRIVAL_EARLY);
    assert_int_equal(receive(r, &x->packet[99]), SFEM_ARRIVAL_EARLY);
    assert_int_equal(sfem_receiver_lead(r), 99); /* so that who steps by it catches up */
    assert_int_equal(receive(r, &x->packet[100]), SFEM_ARRIVAL_TAKEN);
    assert_int_equal(state_hash(r), motion_hash(&x->state[100]));
    info = sfem_receiver_get_info(r);
    assert_int_equal(info.jumps, 1);
    assert_int_equal(info.skipped, 100);
    assert_int_equal(info.sequence, 100);
    assert_int_equal(sfem_receiver_lead(r), 0);
    assert_int_equal(receive(r, &x->packet[99]),
                     SFEM_ARRIVAL_DROPPED); /* older than the key frame */
    receive(r, &x->packet[101]);
    sfem_receiver_step(r);
    assert_follows(r, &x->state[101]);
    sfem_receiver_free(r);
    free(x);
}

/* A packet of an old stream, or one that came through with a wrong number: who steps by the lead would run after
 * it. */
static void one_packet_far_ahead_leads_nowhere(void **state)
{
    const sfem_link_def d = link_def(0);
    sfem_receiver *r = receiver_new(&d);
    recording *x = record(&d, motion_new(0.25, 0.5, 10));
    packet stray = x->packet[5];
    int i;
    (void)state;
    receive(r, &x->packet[0]);
    for (i = 1; i < 20; ++i) {
        stray.byte[17] = (unsigned char)(12 * i); /* a sequence number of 3077 and more, each time another */
        sign(&stray);
        assert_int_equal(receive(r, &stray), SFEM_ARRIVAL_EARLY);
        assert_int_equal(receive(r, &stray), SFEM_ARRIVAL_EARLY); /* twice the same proves nothing */
        assert_int_equal(sfem_receiver_lead(r), 0);
        assert_int_equal(receive(r, &x->packet[i]), SFEM_ARRIVAL_TAKEN);
        assert_int_equal(sfem_receiver_lead(r), 1);
        assert_int_equal(sfem_receiver_step(r), 1);
    }
    assert_follows(r, &x->state[19]);
    assert_int_equal(receive(r, &x->packet[120]), SFEM_ARRIVAL_EARLY); /* 100 packets were lost */
    assert_int_equal(sfem_receiver_lead(r), 0);
    assert_int_equal(receive(r, &x->packet[119]), SFEM_ARRIVAL_EARLY);
    assert_int_equal(sfem_receiver_lead(r), 101);
    while (sfem_receiver_lead(r) > 0) sfem_receiver_step(r);
    assert_int_equal(receive(r, &x->packet[121]), SFEM_ARRIVAL_TAKEN);
    assert_int_equal(sfem_receiver_lead(r), 1);
    sfem_receiver_free(r);
    free(x);
}

static void a_restarted_receiver_follows_a_new_stream(void **state)
{
    sfem_link_def d = link_def(0);
    sfem_receiver *r = receiver_new(&d);
    recording *x = record(&d, motion_new(0.25, 0.5, 10)), *y;
    const sfem_real zero[M] = {0};
    int i;
    (void)state;
    d.stream = 77;
    d.first = 123;
    y = record(&d, motion_new(0.25, 0.5, 3));
    for (i = 0; i < 20; ++i) {
        receive(r, &x->packet[i]);
        if (i) sfem_receiver_step(r);
    }
    assert_int_equal(receive(r, &y->packet[0]), SFEM_ARRIVAL_FOREIGN);
    sfem_receiver_restart(r, 77);
    assert_memory_equal(sfem_receiver_coordinate_velocities(r), zero, sizeof zero);
    assert_int_equal(receive(r, &x->packet[20]), SFEM_ARRIVAL_FOREIGN);
    for (i = 0; i < 20; ++i) {
        assert_int_equal(receive(r, &y->packet[i]), SFEM_ARRIVAL_TAKEN);
        if (i) sfem_receiver_step(r);
    }
    assert_follows(r, &y->state[19]);
    assert_int_equal(sfem_receiver_get_info(r).sequence, 123 + 19);
    sfem_receiver_free(r);
    free(x);
    free(y);
}

/* the same losses, delays and repetitions with numbers that wrap and with numbers that do not */
static void sequence_numbers_wrap(void **state)
{
    static const uint32_t first[4] = {1000, 0xffffffffu, 0xffffff80u, 0x7fffffb0u};
    uint64_t hash[4];
    int which, i;
    (void)state;
    for (which = 0; which < 4; ++which) {
        sfem_link_def d = link_def(17);
        sfem_receiver *r;
        recording *x;
        test_random random = {21};
        sfem_receiver_info info;
        d.first = first[which];
        r = receiver_new(&d);
        x = record(&d, motion_new(0.25, 0.5, 10));
        hash[which] = 0;
        for (i = 0; i <= STEPS; ++i) {
            if (!i || random_below(&random, 4)) receive(r, &x->packet[i]);
            if (i) sfem_receiver_step(r);
            if (random_below(&random, 4) == 0)
                receive(r, &x->packet[i > 9 ? i - random_below(&random, 10) : 0]);
            hash[which] = hash[which] * 31 + state_hash(r);
        }
        info = sfem_receiver_get_info(r);
        assert_int_equal(info.sequence, (uint32_t)(first[which] + STEPS));
        assert_int_equal(info.jumps, 0);
        assert_true(info.arrivals[SFEM_ARRIVAL_LATE] > 0 &&
                    info.arrivals[SFEM_ARRIVAL_REPEATED] > 0);
        assert_int_equal(hash[which], hash[0]);
        sfem_receiver_free(r);
        free(x);
    }
}

/* A warped bar, pushed, grabbed by its tip, pulled, let go: the receiver has the same accelerations at
 * every step, and the same coordinates to rounding, with late packets as without. */
static void follow_through_handles(int damped)
{
    enum { MODES = 12 };
    sfem_real stiffness[MODES], damping[MODES];
    const sfem_int cells[3] = {6, 2, 2}, pins[9] = {0, 1, 2, 3, 4, 5, 6, 7, 8};
    const sfem_real size[3] = {0.6, 0.2, 0.2}, push[3] = {0, 3, 5};
    sfem_model_def model_def = linear_model_def();
    sfem_modes_def modes_def = sfem_default_modes_def();
    sfem_reduced_def reduced_def = sfem_default_reduced_def();
    sfem_modal_def def = sfem_default_modal_def();
    sfem_link_def link = sfem_default_link_def();
    sfem_mesh mesh;
    sfem_model *model;
    sfem_modes modes;
    sfem_reduced *reduced;
    sfem_modal *body;
    sfem_sender *sender;
    sfem_receiver *r;
    sfem_real target[3], q = 0, v = 0; /* the largest so far */
    sfem_int handle = -1;
    sfem_error err;
    packet p, last;
    int i, k, held_steps = 0;
    assert_ok(sfem_mesh_block(cells, size, SFEM_CELL_5_TETS, NULL, &mesh, &err), err);
    model_def.mesh = &mesh;
    assert_ok(sfem_model_create(&model_def, &model, &err), err);
    modes_def.modes = MODES;
    modes_def.pins = pins;
    modes_def.pin_count = 9;
    assert_ok(sfem_modes_create(model, &modes_def, &modes, &err), err);
    if (damped) reduced_def.mass_damping = 1, reduced_def.stiffness_damping = 0.3 / sqrt(modes.lambda[0]);
    assert_ok(sfem_reduced_create(model, &modes, &reduced_def, &reduced, &err), err);
    def.h = link.h; /* of the q'' that the first packet carries */
    assert_ok(sfem_modal_create(reduced, &def, &body, &err), err);
    sfem_modal_oscillators(body, link.h, stiffness, damping);
    link.modes = MODES;
    link.key_every = 0;
    link.lost = SFEM_LOST_PREDICTED;
    link.stiffness = stiffness;
    link.damping = damping;
    sender = sender_new(&link);
    r = receiver_new(&link);
    assert_ok(sfem_modal_add_lasting_force(body, mesh.nodes - 1, push, &err), err);
    sfem_modal_start(body);
    last.bytes = 0;
    for (i = 0; i < 200; ++i) {
        if (i == 60) {
            assert_ok(sfem_modal_grab_node(body, mesh.nodes - 1, &handle, &err), err);
            sfem_modal_handle_position(body, handle, target);
        }
        if (i >= 60 && i < 120) {
            target[1] += 0.001;
            assert_ok(sfem_modal_move_handle(body, handle, target, &err), err);
        }
        if (i == 120) sfem_modal_release_handle(body, handle);
        if (i) {
            sfem_modal_info info;
            assert_ok(sfem_modal_step(body, link.h, &err), err);
            info = sfem_modal_get_info(body);
            sfem_sender_set_held(sender, info.gamma > 0.5);
            held_steps += info.gamma > 0.5;
        }
        p = send_state(sender, sfem_modal_coordinates(body), sfem_modal_coordinate_velocities(body),
                       sfem_modal_coordinate_accelerations(body));
        if (i % 5 != 3) receive(r, &p); /* every fifth comes one step late, key frames in time */
        if (i) sfem_receiver_step(r);
        if (i % 5 == 4) assert_int_equal(receive(r, &last), SFEM_ARRIVAL_LATE);
        last = p;
        if (i % 5 == 3) continue;
        for (k = 0; k < MODES; ++k) {
            q = fmax(q, fabs(sfem_modal_coordinates(body)[k]));
            v = fmax(v, fabs(sfem_modal_coordinate_velocities(body)[k]));
        }
        assert_all_near(sfem_receiver_coordinates(r), sfem_modal_coordinates(body), MODES, 0,
                        1e-13 * q);
        assert_all_near(sfem_receiver_coordinate_velocities(r), sfem_modal_coordinate_velocities(body), MODES, 0,
                        1e-13 * v);
        assert_memory_equal(sfem_receiver_coordinate_accelerations(r), sfem_modal_coordinate_accelerations(body),
                            MODES * sizeof(sfem_real));
    }
    assert_int_equal(held_steps, 60);
    assert_int_equal(sfem_receiver_get_info(r).keys, 3);
    sfem_sender_free(sender);
    sfem_receiver_free(r);
    sfem_modal_free(body);
    sfem_reduced_free(reduced);
    sfem_modes_free(&modes);
    sfem_model_free(model);
    sfem_mesh_free(&mesh);
}

static void a_modal_body_is_followed_through_handles(void **state)
{
    (void)state;
    follow_through_handles(0);
}

static void a_damped_modal_body_is_followed_through_handles(void **state)
{
    (void)state;
    follow_through_handles(1);
}

/* --------------------------------------------------------------------------------------------
 * losses
 * -------------------------------------------------------------------------------------------- */

static void lost_accelerations_are_replaced_as_told(void **state)
{
    int lost, i, k;
    (void)state;
    for (lost = SFEM_LOST_ZERO; lost <= SFEM_LOST_EXTRAPOLATED; ++lost) {
        sfem_link_def d = link_def(0);
        sfem_receiver *r;
        recording *x = record(&d, motion_new(0.25, 0.5, 10));
        d.lost = (sfem_lost)lost;
        r = receiver_new(&d);
        receive(r, &x->packet[0]);
        for (i = 1; i <= 20; ++i) { /* 1, 18, 19 and 20 are missing */
            if (i > 1 && i < 18) receive(r, &x->packet[i]);
            sfem_receiver_step(r);
            for (k = 0; (i == 1 || i > 17) && k < M; ++k) {
                const sfem_real a17 = x->state[17].a[k], a16 = x->state[16].a[k];
                sfem_real wanted = 0;
                if (lost != SFEM_LOST_ZERO) wanted = i == 1 ? x->state[0].a[k] : a17;
                if (lost == SFEM_LOST_EXTRAPOLATED && i > 1) wanted = 2 * a17 - a16;
                assert_true(sfem_receiver_coordinate_accelerations(r)[k] == wanted);
            }
        }
        assert_int_equal(sfem_receiver_get_info(r).lost, 4);
        sfem_receiver_free(r);
        free(x);
    }
}

/* nine packets of ten lost, and a constant load that the receiver is told nothing of */
static void a_predicted_loss_costs_nothing_under_constant_load(void **state)
{
    motion s = motion_new(0.3025, 0.6, 10);
    sfem_link_def d = link_def(0);
    sfem_sender *sender;
    sfem_receiver *r;
    int i, k;
    (void)state;
    s.rate = 0;
    d.beta = s.beta;
    d.gamma = s.gamma;
    d.lost = SFEM_LOST_PREDICTED;
    d.stiffness = s.k;
    d.damping = s.c;
    sender = sender_new(&d);
    r = receiver_new(&d);
    for (i = 0; i <= STEPS; ++i) {
        const packet p = send(sender, &s);
        if (i % 10 == 0) receive(r, &p);
        if (i) sfem_receiver_step(r);
        for (k = 0; k < M; ++k) { /* the error of the load, rounding of k q, adds up over the run */
            assert_near(sfem_receiver_coordinates(r)[k], s.q[k], 0, 1e-11);
            assert_near(sfem_receiver_coordinate_velocities(r)[k], s.v[k], 0, 1e-11 * sqrt(s.k[k]));
        }
        motion_step(&s);
    }
    sfem_sender_free(sender);
    sfem_receiver_free(r);
}

/* The load jumps with step 50, whose packet comes late by none, one or two steps; from 53 on all is
 * lost. Two accelerations under the new load are enough to predict all others, unless the predictor
 * keeps what it had taken for them. */
static void a_late_packet_mends_the_prediction(void **state)
{
    int late, key;
    (void)state;
    for (late = 0; late < 3; ++late) {
        for (key = 0; key < 2; ++key) {
            motion s = motion_new(0.25, 0.5, 10);
            sfem_link_def d = link_def(0);
            sfem_sender *sender;
            sfem_receiver *r;
            packet kept;
            int i, k;
            d.lost = SFEM_LOST_PREDICTED;
            d.stiffness = s.k;
            d.damping = s.c;
            s.rate = 0;
            sender = sender_new(&d);
            r = receiver_new(&d);
            kept.bytes = 0;
            for (i = 0; i < 80; ++i) {
                packet p;
                if (i == 50) s.loads = -25;
                if (i) motion_step(&s);
                if (i == 50 && key) sfem_sender_request_key(sender);
                p = send(sender, &s);
                if (i == 50) kept = p;
                if (i < 50 || i == 51 || (i == 52 && late > 1)) receive(r, &p);
                if (i) sfem_receiver_step(r);
                if (i == 50 + late) assert_int_equal(receive(r, &kept), SFEM_ARRIVAL_LATE);
                for (k = 0; i >= 50 + late && k < M; ++k)
                    assert_near(sfem_receiver_coordinates(r)[k], s.q[k], 0, 1e-11);
            }
            sfem_sender_free(sender);
            sfem_receiver_free(r);
        }
    }
}

/* The key frame of the change is lost for ever. A packet of the new method that comes late means the
 * same as in time, and one that never comes distorts by that method's gamma and beta. */
static void the_method_of_a_late_step_is_its_own(void **state)
{
    sfem_link_def d = link_def(0), narrow;
    motion s = motion_new(d.beta, d.gamma, 10);
    sfem_sender *sender;
    sfem_receiver *r, *punctual;
    sfem_receiver *short_sighted;
    packet kept;
    int i, k;
    (void)state;
    d.lost = SFEM_LOST_PREDICTED;
    d.stiffness = s.k;
    sender = sender_new(&d);
    r = receiver_new(&d);
    punctual = receiver_new(&d);
    narrow = d;
    narrow.window = 8;
    short_sighted = receiver_new(&narrow);
    kept.bytes = 0;
    for (i = 0; i < 60; ++i) {
        const int held = i >= 30;
        sfem_real dq[M], dv[M], a49[M];
        packet p;
        s.beta = held ? d.held_beta : d.beta;
        s.gamma = held ? d.held_gamma : d.gamma;
        if (i) motion_step(&s);
        sfem_sender_set_held(sender, held);
        p = send(sender, &s);
        if (i == 31) kept = p;
        for (k = 0; k < M; ++k) {
            dq[k] = -sfem_receiver_coordinates(punctual)[k];
            dv[k] = -sfem_receiver_coordinate_velocities(punctual)[k];
            a49[k] = sfem_receiver_coordinate_accelerations(punctual)[k];
        }
        if (i != 30 && i != 50) receive(punctual, &p);
        if (i != 30 && i != 31 && i != 50) receive(r, &p), receive(short_sighted, &p);
        if (i) {
            sfem_receiver_step(r);
            sfem_receiver_step(punctual);
            sfem_receiver_step(short_sighted);
        }
        if (i == 36) assert_int_equal(receive(r, &kept), SFEM_ARRIVAL_LATE);
        if (i == 38) /* the step before it is out of the window by now */
            assert_int_equal(receive(short_sighted, &kept), SFEM_ARRIVAL_DROPPED);
        for (k = 0; i > 36 && k < M; ++k) {
            const sfem_real *q = sfem_receiver_coordinates(punctual);
            const sfem_real *v = sfem_receiver_coordinate_velocities(punctual);
            assert_near(sfem_receiver_coordinates(r)[k], q[k], 1e-12, 1e-12);
            assert_near(sfem_receiver_coordinate_velocities(r)[k], v[k], 1e-12, 1e-12);
        }
        for (k = 0; i == 50 && k < M; ++k) { /* a lost step, by what was taken for it */
            const sfem_real v49 = -dv[k], a50 = sfem_receiver_coordinate_accelerations(punctual)[k];
            dv[k] += sfem_receiver_coordinate_velocities(punctual)[k];
            dq[k] += sfem_receiver_coordinates(punctual)[k];
            assert_near(dv[k], s.h * ((1 - d.held_gamma) * a49[k] + d.held_gamma * a50), 1e-11,
                        1e-11);
            assert_near(dq[k] - s.h * v49,
                        s.h * s.h * ((0.5 - d.held_beta) * a49[k] + d.held_beta * a50), 1e-11,
                        1e-12);
        }
    }
    sfem_sender_free(sender);
    sfem_receiver_free(r);
    sfem_receiver_free(punctual);
    sfem_receiver_free(short_sighted);
}

/* Largest distortion of the displacement, in units of h^2 times the largest acceleration of its mode;
 * key frames are lost like others, or never. */
static sfem_real distortion(sfem_lost lost, int percent, sfem_int key_every, int lose_keys,
                            int steps)
{
    motion s = motion_new(0.25, 0.5, 10);
    sfem_link_def d = link_def(key_every);
    test_random random = {33};
    sfem_sender *sender;
    sfem_receiver *r;
    sfem_real worst[M] = {0}, largest[M] = {0}, result = 0;
    int i, k;
    d.lost = lost;
    d.stiffness = s.k;
    d.damping = s.c;
    sender = sender_new(&d);
    r = receiver_new(&d);
    for (i = 0; i <= steps; ++i) {
        const int key = sfem_sender_key_due(sender);
        const packet p = send(sender, &s);
        const int arrives = random_below(&random, 100) >= percent;
        if (!i || arrives || (key && !lose_keys)) receive(r, &p);
        if (i) sfem_receiver_step(r);
        for (k = 0; k < M; ++k) {
            const sfem_real off = fabs(sfem_receiver_coordinates(r)[k] - s.q[k]);
            worst[k] = fmax(worst[k], off);
            largest[k] = fmax(largest[k], fabs(s.a[k]));
        }
        motion_step(&s);
    }
    for (k = 0; k < M; ++k) result = fmax(result, worst[k] / (s.h * s.h * largest[k]));
    sfem_sender_free(sender);
    sfem_receiver_free(r);
    return result;
}

/* By the theorem the lost of 29 accelerations between two key frames add up to less than 1/4 + 1 + ... +
 * 28 times h^2 times the largest; what is held in their place is off by twice that at most, and so on. */
static void with_key_frames_distortion_is_bounded(void **state)
{
    static const sfem_real off[4] = {1, 2, 4, 1};
    int lost, percent;
    (void)state;
    for (lost = SFEM_LOST_ZERO; lost <= SFEM_LOST_PREDICTED; ++lost) {
        assert_true(distortion((sfem_lost)lost, 0, 30, 1, 1000) < 1e-10);
        for (percent = 5; percent <= 30; percent += 5) {
            const sfem_real more = distortion((sfem_lost)lost, percent, 30, 0, 40000);
            assert_true(more > 0.1 && more < off[lost] * 406.25);
            /* key frames get lost, too: the longest run without one grows like a logarithm */
            assert_true(distortion((sfem_lost)lost, percent, 30, 1, 40000) < 30 * more);
        }
    }
}

static void without_key_frames_distortion_grows(void **state)
{
    const sfem_real some = distortion(SFEM_LOST_ZERO, 10, 0, 1, 1000);
    const sfem_real more = distortion(SFEM_LOST_ZERO, 10, 0, 1, 40000);
    (void)state;
    assert_true(more > 10 * some);
    assert_true(more > 100 * distortion(SFEM_LOST_ZERO, 10, 30, 1, 40000));
}

/* A predictor that fed its own errors back would blow up here. */
static void predictions_stay_bounded_at_any_loss(void **state)
{
    int percent;
    (void)state;
    for (percent = 40; percent < 100; percent += 10)
        assert_true(distortion(SFEM_LOST_PREDICTED, percent, 30, 0, 20000) < 100);
}

static void floats_halve_the_bytes_and_cost_seven_digits(void **state)
{
    sfem_link_def d = link_def(20);
    sfem_receiver *r;
    sfem_sender *s;
    recording *x;
    sfem_real huge[M] = {0}, zero[M] = {0};
    sfem_error err;
    packet p;
    int i, k;
    (void)state;
    d.precision = SFEM_MIXED;
    r = receiver_new(&d);
    x = record(&d, motion_new(0.25, 0.5, 10));
    assert_int_equal(x->packet[1].bytes, 32 + 4 * M);
    for (i = 0; i <= STEPS; ++i) {
        assert_int_equal(receive(r, &x->packet[i]), SFEM_ARRIVAL_TAKEN);
        if (i) sfem_receiver_step(r);
        for (k = 0; k < M; ++k) {
            const motion *m = &x->state[i];
            const sfem_real round = 6e-8; /* 2^-24 */
            /* h^2 times the sum of up to 20 * 20 roundings of the acceleration, and the key frame's */
            const sfem_real amplitude = 2 * (m->k[k] + 10 * (k + 1));
            assert_near(sfem_receiver_coordinates(r)[k], m->q[k], 0,
                        round * (4 + 400 * m->h * m->h * amplitude));
        }
    }
    s = sender_new(&d);
    huge[3] = 3.5e38;
    assert_status(sfem_sender_write(s, zero, huge, zero, p.byte, sizeof p.byte, &p.bytes, &err),
                  SFEM_NOT_FINITE);
    assert_names(err, "mode 3: q' = 3.5e+38");
    sfem_sender_free(s);
    sfem_receiver_free(r);
    free(x);
}

/* --------------------------------------------------------------------------------------------
 * errors, memory
 * -------------------------------------------------------------------------------------------- */

static void a_packet_that_cannot_be_written_does_not_count(void **state)
{
    const sfem_link_def d = link_def(0);
    sfem_sender *s = sender_new(&d);
    sfem_real zero[M] = {0}, bad[M] = {0};
    const size_t size = sfem_sender_packet_size(s);
    sfem_error err;
    packet p;
    (void)state;
    bad[2] = NAN;
    p.bytes = 12345;
    assert_status(sfem_sender_write(s, zero, zero, zero, p.byte, size - 1, &p.bytes, &err),
                  SFEM_FULL);
    assert_names(err, "200 bytes, not 199");
    assert_status(sfem_sender_write(s, NULL, zero, zero, p.byte, size, &p.bytes, &err),
                  SFEM_BAD_ARGUMENT);
    assert_status(sfem_sender_write(s, zero, NULL, zero, p.byte, size, &p.bytes, NULL),
                  SFEM_BAD_ARGUMENT);
    assert_status(sfem_sender_write(s, zero, zero, bad, p.byte, size, &p.bytes, &err),
                  SFEM_NOT_FINITE);
    assert_names(err, "mode 2: q''");
    assert_status(sfem_sender_write(s, bad, zero, zero, p.byte, size, &p.bytes, &err),
                  SFEM_NOT_FINITE);
    assert_int_equal(p.bytes, 12345);
    p = send_state(s, zero, zero, zero);
    assert_int_equal(p.byte[9], 2);
    assert_int_equal(p.byte[16], 0);
    p = send_state(s, bad, bad, zero); /* not read */
    assert_int_equal(p.byte[16], 1);
    sfem_sender_free(s);
}

static void definitions_out_of_range_are_refused(void **state)
{
    const sfem_real bad[M] = {1, 1, -1, 1, 1, 1, 1}, good[M] = {0};
    sfem_receiver *r = NULL;
    sfem_sender *s = NULL;
    int i;
    (void)state;
    for (i = 0; i < 13; ++i) {
        sfem_link_def d = link_def(0);
        sfem_error err;
        sfem_status wanted = SFEM_BAD_ARGUMENT;
        switch (i) {
        case 0:
            d.modes = 0;
            break;
        case 1:
            d.h = 0;
            break;
        case 2:
            d.h = NAN, wanted = SFEM_NOT_FINITE;
            break;
        case 3:
            d.beta = -1;
            break;
        case 4:
            d.gamma = HUGE_VAL, wanted = SFEM_NOT_FINITE;
            break;
        case 5:
            d.key_every = -1;
            break;
        case 6:
            d.window = 3;
            break;
        case 7:
            d.window = 32769;
            break;
        case 8:
            d.lost = (sfem_lost)4;
            break;
        case 9:
            d.lost = SFEM_LOST_PREDICTED;
            break;
        case 10:
            d.stiffness = bad;
            break;
        case 11:
            d.stiffness = good, d.damping = bad;
            break;
        default:
            d.modes = INT32_MAX, d.window = 32768;
            break;
        }
        if (i == 12) wanted = SFEM_OUT_OF_MEMORY; /* 3 10^15 bytes */
        if (i == 12 && sizeof(size_t) < 8) wanted = SFEM_TOO_LARGE;
        if (i == 12) {
            test_memory memory = {0};
            memory.fail_at = 2; /* without asking the system for so much */
            d.allocator = test_allocator(&memory);
            assert_status(sfem_receiver_create(&d, &r, &err), wanted);
            assert_no_leak(memory);
            break;
        }
        assert_status(sfem_receiver_create(&d, &r, &err), wanted);
        assert_true(strlen(err.text) > 5);
        if (i < 10) assert_status(sfem_sender_create(&d, &s, &err), wanted);
        assert_null(r);
        assert_null(s);
    }
    sfem_receiver_free(NULL);
    sfem_sender_free(NULL);
}

static sfem_status make_both(sfem_allocator allocator, void *user, sfem_error *err)
{
    sfem_link_def d = link_def(0);
    sfem_receiver *r = NULL;
    sfem_sender *s = NULL;
    sfem_status status;
    d.allocator = allocator;
    d.stiffness = d.damping = (const sfem_real *)user;
    status = sfem_sender_create(&d, &s, err);
    if (status == SFEM_OK) status = sfem_receiver_create(&d, &r, err);
    sfem_sender_free(s);
    sfem_receiver_free(r);
    return status;
}

static void every_allocation_may_fail(void **state)
{
    sfem_real zero[M] = {0};
    (void)state;
    assert_int_equal(fail_every_allocation(make_both, zero), 7);
}

static void nothing_is_allocated_after_create(void **state)
{
    sfem_link_def d = link_def(10);
    test_memory memory = {0};
    sfem_sender *s;
    sfem_receiver *r;
    motion x = motion_new(0.25, 0.5, 10);
    size_t calls;
    int i;
    (void)state;
    d.allocator = test_allocator(&memory);
    s = sender_new(&d);
    r = receiver_new(&d);
    calls = memory.calls;
    for (i = 0; i < 300; ++i) {
        const packet p = send(s, &x);
        if (i % 4) receive(r, &p);
        sfem_receiver_step(r);
        receive(r, &p);
        motion_step(&x);
    }
    sfem_receiver_restart(r, 1);
    assert_int_equal(memory.calls, calls);
    sfem_sender_free(s);
    sfem_receiver_free(r);
    assert_no_leak(memory);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(without_loss_the_receiver_follows),
        cmocka_unit_test(one_lost_acceleration_distorts_as_the_theorem_says),
        cmocka_unit_test(the_theorem_holds_for_the_average_acceleration),
        cmocka_unit_test(the_theorem_holds_for_other_newmark_methods),
        cmocka_unit_test(a_packet_has_these_bytes),
        cmocka_unit_test(every_damaged_packet_is_recognised),
        cmocka_unit_test(a_packet_of_another_link_is_foreign),
        cmocka_unit_test(sound_nonsense_is_corrupted),
        cmocka_unit_test(no_bytes_make_a_nan),
        cmocka_unit_test(numbers_that_overflow_stop_the_mode),
        cmocka_unit_test(repeated_packets_change_nothing),
        cmocka_unit_test(reordered_packets_wait_for_their_step),
        cmocka_unit_test(a_late_acceleration_is_put_right_exactly),
        cmocka_unit_test(a_run_of_late_packets_is_put_right),
        cmocka_unit_test(a_late_key_frame_is_the_same_as_one_in_time),
        cmocka_unit_test(what_comes_too_late_or_unwanted_is_dropped),
        cmocka_unit_test(a_key_frame_puts_the_receiver_where_the_sender_is),
        cmocka_unit_test(key_frames_come_when_due_or_asked_for),
        cmocka_unit_test(before_the_first_key_frame_nothing_moves),
        cmocka_unit_test(steps_of_two_methods_are_told_apart),
        cmocka_unit_test(a_modal_body_is_followed_through_handles),
        cmocka_unit_test(a_damped_modal_body_is_followed_through_handles),
        cmocka_unit_test(a_receiver_that_fell_behind_goes_on_at_a_key_frame),
        cmocka_unit_test(one_packet_far_ahead_leads_nowhere),
        cmocka_unit_test(a_restarted_receiver_follows_a_new_stream),
        cmocka_unit_test(sequence_numbers_wrap),
        cmocka_unit_test(lost_accelerations_are_replaced_as_told),
        cmocka_unit_test(a_predicted_loss_costs_nothing_under_constant_load),
        cmocka_unit_test(a_late_packet_mends_the_prediction),
        cmocka_unit_test(the_method_of_a_late_step_is_its_own),
        cmocka_unit_test(with_key_frames_distortion_is_bounded),
        cmocka_unit_test(without_key_frames_distortion_grows),
        cmocka_unit_test(predictions_stay_bounded_at_any_loss),
        cmocka_unit_test(floats_halve_the_bytes_and_cost_seven_digits),
        cmocka_unit_test(a_packet_that_cannot_be_written_does_not_count),
        cmocka_unit_test(definitions_out_of_range_are_refused),
        cmocka_unit_test(every_allocation_may_fail),
        cmocka_unit_test(nothing_is_allocated_after_create),
    };
    return run_all_tests(tests);
}
