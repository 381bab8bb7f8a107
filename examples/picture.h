/* picture.h - shaded pictures of surfaces as .png, drawn in software. Included by support.h.
 *
 *     ex_picture *p = ex_picture_new(1200, 800);
 *     p->ground = 0;                                     ground at z = 0; NAN, as it is: none
 *     p->bar = 1;                                        room for ex_colorbar
 *     ex_view_begin(p, 0, 1, 1, lower, upper, direction) view 0 of 1 x 1, a contact sheet of 3 x 2:
 *     ex_view_surface(p, nodes, x, n, triangles, value, &style)         (p, k, 3, 2, ...), k = 0..5
 *     ex_view_line(p, a, b, width, color)                an arrow's shaft, or a dot where a = b
 *     ex_view_end(p, "t = 0.2 s");
 *     ex_colorbar(p, "stress, Pa", low, high);           ex_label(p, x, y, size, align, text)
 *     ex_picture_write(p, "body.png");                   ex_picture_write_small(p, ...) in 256 colours
 *     ex_picture_free(p);
 *
 * x is [nodes][3] doubles, triangles [n][3] node numbers, counter-clockwise from outside; value
 * [nodes], or NULL for one colour. ex_bounds gives the box, ex_range the ends of the colour scale.
 */
#ifndef SFEM_EXAMPLES_PICTURE_H
#define SFEM_EXAMPLES_PICTURE_H

/* --------------------------------------------------------------------------------------------
 * PNG: 8-bit RGB, rows as differences from above, from the left or from both, or a palette; deflated with codes of
 * their own [RFC 1950, 1951, 2083]
 * -------------------------------------------------------------------------------------------- */

typedef struct ex_bytes {
    unsigned char *data;
    size_t count, capacity;
    uint32_t bits; /* not yet written, lowest first */
    int bit_count;
} ex_bytes;

EX_STATIC void ex_byte(ex_bytes *b, unsigned value)
{
    if (b->count == b->capacity) {
        unsigned char *more;
        b->capacity = b->capacity ? 2 * b->capacity : 4096;
        more = (unsigned char *)realloc(b->data, b->capacity);
        if (!more) ex_fail("out of memory");
        b->data = more;
    }
    b->data[b->count++] = (unsigned char)(value & 255);
}

EX_STATIC void ex_word(ex_bytes *b, uint32_t value) /* highest byte first */
{
    int shift;
    for (shift = 24; shift >= 0; shift -= 8) ex_byte(b, value >> shift);
}

EX_STATIC void ex_bits(ex_bytes *b, uint32_t value, int count)
{
    b->bits |= value << b->bit_count;
    for (b->bit_count += count; b->bit_count >= 8; b->bit_count -= 8, b->bits >>= 8)
        ex_byte(b, b->bits);
}

EX_STATIC void ex_code(ex_bytes *b, uint32_t code, int count) /* Huffman codes: highest bit first */
{
    while (count--) ex_bits(b, (code >> count) & 1, 1);
}

/* Lengths 3.. and distances 1.. share a pattern: the first 2 m values have a code of their own,
 * then every m codes cover twice as many values, told apart by one more bit each. */
EX_STATIC uint32_t ex_class(uint32_t value, uint32_t m, int *extra_bits, uint32_t *extra)
{
    uint32_t size = 1, first = 0, code;
    *extra_bits = 0;
    for (code = 0;; ++code) {
        if (code >= 2 * m && code % m == 0) {
            size *= 2;
            ++*extra_bits;
        }
        if (value < first + size) break;
        first += size;
    }
    *extra = value - first;
    return code;
}

typedef struct ex_codes { /* Huffman's, of literals and lengths, of distances, or of lengths of codes */
    int count;
    uint32_t used[288], code[288];
    unsigned char length[288]; /* bits; 0: unused */
} ex_codes;

/* The lengths of optimal codes; where one is longer than most, of flatter and flatter counts. */
EX_STATIC void ex_codes_lengths(ex_codes *c, int most)
{
    enum { NODES = 2 * 288 };
    uint32_t weight[NODES];
    int parent[NODES], i, nodes, pair[2], left, longest;
    for (i = 0; i < 2; ++i) c->used[i] += c->used[i] == 0; /* at least two codes */
    do {
        for (left = 0, i = 0; i < c->count; ++i) {
            weight[i] = c->used[i];
            parent[i] = -1;
            left += weight[i] > 0;
        }
        for (nodes = c->count; left > 1; --left, ++nodes) { /* the two lightest get a parent */
            pair[0] = pair[1] = -1;
            for (i = 0; i < nodes; ++i) {
                if (!weight[i] || parent[i] >= 0) continue;
                if (pair[0] < 0 || weight[i] < weight[pair[0]])
                    pair[1] = pair[0], pair[0] = i;
                else if (pair[1] < 0 || weight[i] < weight[pair[1]])
                    pair[1] = i;
            }
            weight[nodes] = weight[pair[0]] + weight[pair[1]];
            parent[nodes] = -1;
            parent[pair[0]] = parent[pair[1]] = nodes;
        }
        for (longest = 0, i = 0; i < c->count; ++i) {
            int up = i, bits = 0;
            while (weight[i] && parent[up] >= 0) up = parent[up], ++bits;
            c->length[i] = (unsigned char)bits;
            if (bits > longest) longest = bits;
            c->used[i] = (c->used[i] + 1) / 2;
        }
    } while (longest > most);
}

EX_STATIC void ex_codes_make(ex_codes *c, int most)
{
    uint32_t next = 0;
    int bits, i;
    ex_codes_lengths(c, most);
    for (bits = 1; bits <= most; ++bits, next <<= 1)
        for (i = 0; i < c->count; ++i)
            if (c->length[i] == bits) c->code[i] = next++;
}

EX_STATIC void ex_symbol(ex_bytes *b, const ex_codes *c, uint32_t symbol)
{
    ex_code(b, c->code[symbol], c->length[symbol]);
}

typedef struct ex_token { /* a byte, or a match of length and distance */
    uint16_t value, distance; /* distance 0: a byte */
} ex_token;

/* The codes' lengths, one by one, by codes of their own. */
EX_STATIC void ex_block_head(ex_bytes *b, const ex_codes *literals, const ex_codes *distances, int last)
{
    static const unsigned char order[19] = {16, 17, 18, 0, 8, 7, 9, 6, 10, 5, 11, 4, 12, 3, 13, 2, 14, 1, 15};
    ex_codes lengths;
    int i;
    memset(&lengths, 0, sizeof lengths);
    lengths.count = 19;
    for (i = 0; i < literals->count; ++i) ++lengths.used[literals->length[i]];
    for (i = 0; i < distances->count; ++i) ++lengths.used[distances->length[i]];
    ex_codes_make(&lengths, 7);
    ex_bits(b, last ? 5 : 4, 3);
    ex_bits(b, (uint32_t)literals->count - 257, 5);
    ex_bits(b, (uint32_t)distances->count - 1, 5);
    ex_bits(b, 15, 4);
    for (i = 0; i < 19; ++i) ex_bits(b, lengths.length[order[i]], 3);
    for (i = 0; i < literals->count; ++i) ex_symbol(b, &lengths, literals->length[i]);
    for (i = 0; i < distances->count; ++i) ex_symbol(b, &lengths, distances->length[i]);
}

EX_STATIC void ex_block(ex_bytes *b, const ex_token *token, size_t count, int last)
{
    ex_codes literals, distances;
    uint32_t extra, code;
    int pass, bits;
    size_t i;
    memset(&literals, 0, sizeof literals);
    memset(&distances, 0, sizeof distances);
    literals.count = 286;
    distances.count = 30;
    literals.used[256] = 1;
    for (pass = 0; pass < 2; ++pass) { /* 0: counts, 1: writes */
        for (i = 0; i < count; ++i) {
            if (!token[i].distance) {
                if (pass)
                    ex_symbol(b, &literals, token[i].value);
                else
                    ++literals.used[token[i].value];
                continue;
            }
            code = 257 + ex_class(token[i].value - 3u, 4, &bits, &extra);
            if (pass)
                ex_symbol(b, &literals, code), ex_bits(b, extra, bits);
            else
                ++literals.used[code];
            code = ex_class(token[i].distance - 1u, 2, &bits, &extra);
            if (pass)
                ex_symbol(b, &distances, code), ex_bits(b, extra, bits);
            else
                ++distances.used[code];
        }
        if (pass) break;
        ex_codes_make(&literals, 15);
        ex_codes_make(&distances, 15);
        ex_block_head(b, &literals, &distances, last);
    }
    ex_symbol(b, &literals, 256);
}

EX_STATIC uint32_t ex_slot(const unsigned char *data)
{
    uint32_t four;
    memcpy(&four, data, 4);
    return (four * 2654435761u) >> 17;
}

/* zlib stream: the longest of the last matches whose first 4 bytes are the same */
EX_STATIC void ex_deflate(ex_bytes *b, const unsigned char *data, size_t count)
{
    enum { SLOTS = 1 << 15, WINDOW = 32767, LONGEST = 257, BLOCK = 1 << 15, TRIES = 24 }; /* 258 has a code of its own */
    uint32_t *last = (uint32_t *)ex_new(SLOTS, sizeof *last), *before = (uint32_t *)ex_new(count, sizeof *before);
    ex_token *token = (ex_token *)ex_new(BLOCK, sizeof *token); /* last, before: place + 1 */
    uint32_t a = 1, c = 0;
    size_t i, k, tokens = 0;
    ex_byte(b, 0x78);
    ex_byte(b, 0x01);
    for (i = 0; i < count;) {
        size_t length = 3, distance = 0;
        uint32_t from = i + 4 <= count ? last[ex_slot(data + i)] : 0;
        int tries;
        for (tries = 0; from && i + 1 - from <= WINDOW && tries < TRIES; ++tries, from = before[from - 1]) {
            for (k = 0; k < LONGEST && i + k < count && data[from - 1 + k] == data[i + k];) ++k;
            if (k <= length) continue;
            length = k;
            distance = i + 1 - from;
        }
        token[tokens].value = (uint16_t)(distance ? length : data[i]);
        token[tokens++].distance = (uint16_t)distance;
        for (k = i, i += distance ? length : 1; k < i && k + 4 <= count; ++k) {
            before[k] = last[ex_slot(data + k)];
            last[ex_slot(data + k)] = (uint32_t)k + 1;
        }
        if (tokens < BLOCK && i < count) continue;
        ex_block(b, token, tokens, i >= count);
        tokens = 0;
    }
    ex_bits(b, 0, 7);             /* fill the last byte */
    for (k = 0; k < count; ++k) { /* Adler-32 */
        a = (a + data[k]) % 65521;
        c = (c + a) % 65521;
    }
    ex_word(b, c << 16 | a);
    free(token);
    free(before);
    free(last);
}

EX_STATIC void ex_chunk(FILE *f, const char *type, const ex_bytes *content)
{
    ex_bytes b;
    uint32_t crc = 0xffffffffu;
    size_t i;
    int k;
    memset(&b, 0, sizeof b);
    ex_word(&b, (uint32_t)content->count);
    for (k = 0; k < 4; ++k) ex_byte(&b, (unsigned char)type[k]);
    for (i = 0; i < content->count; ++i) ex_byte(&b, content->data[i]);
    for (i = 4; i < b.count; ++i)
        for (crc ^= b.data[i], k = 0; k < 8; ++k) crc = crc & 1 ? crc >> 1 ^ 0xedb88320u : crc >> 1;
    ex_word(&b, ~crc);
    fwrite(b.data, 1, b.count, f);
    free(b.data);
}

/* What a byte is expected to be, from those to the left, above, and above to the left: filters 1, 2, 4 (Paeth's). */
EX_STATIC int ex_expected(int filter, int left, int up, int corner)
{
    const int p = left + up - corner, a = abs(p - left), b = abs(p - up), c = abs(p - corner);
    if (filter < 4) return filter == 1 ? left : up;
    return a <= b && a <= c ? left : b <= c ? up : corner;
}

/* by the filter that leaves the smallest numbers */
EX_STATIC void ex_filter_row(unsigned char *out, const unsigned char *row,
                             const unsigned char *above, size_t bytes)
{
    static const int filter[4] = {1, 2, 4, 0};
    long best = -1;
    size_t i;
    int k, chosen = 0;
    for (k = 0; k < 4; ++k) { /* the last time around: written */
        const int f = k < 3 ? filter[k] : chosen;
        long sum = 0;
        if (k == 3) out[0] = (unsigned char)f;
        for (i = 0; i < bytes; ++i) {
            const int left = i >= 3 ? row[i - 3] : 0, up = above ? above[i] : 0;
            const int corner = i >= 3 && above ? above[i - 3] : 0;
            const int d = row[i] - ex_expected(f, left, up, corner);
            if (k == 3) out[i + 1] = (unsigned char)d;
            sum += abs((signed char)d);
        }
        if (k < 3 && (best < 0 || sum < best)) {
            best = sum;
            chosen = f;
        }
    }
}

/* The file: rows of bytes, each after that of its filter; RGB, or numbers of colours if there is a palette. */
EX_STATIC void ex_png_file(const char *path, int width, int height, const unsigned char *rows, size_t row_bytes,
                           const unsigned char *palette, int colors)
{
    static const unsigned char magic[8] = {0x89, 'P', 'N', 'G', '\r', '\n', 0x1a, '\n'};
    const unsigned char kind[5] = {8, (unsigned char)(palette ? 3 : 2), 0, 0, 0}; /* 8 bits, RGB or palette */
    FILE *f = ex_open(path);
    ex_bytes head, table, body, end;
    int k;
    memset(&head, 0, sizeof head);
    memset(&table, 0, sizeof table);
    memset(&body, 0, sizeof body);
    memset(&end, 0, sizeof end);
    ex_word(&head, (uint32_t)width);
    ex_word(&head, (uint32_t)height);
    for (k = 0; k < 5; ++k) ex_byte(&head, kind[k]);
    for (k = 0; k < 3 * colors; ++k) ex_byte(&table, palette[k]);
    ex_deflate(&body, rows, (size_t)height * (row_bytes + 1));
    fwrite(magic, 1, sizeof magic, f);
    ex_chunk(f, "IHDR", &head);
    if (palette) ex_chunk(f, "PLTE", &table);
    ex_chunk(f, "IDAT", &body);
    ex_chunk(f, "IEND", &end);
    ex_close(f, path);
    free(head.data);
    free(table.data);
    free(body.data);
}

EX_STATIC void ex_png_write(const char *path, int width, int height, const unsigned char *rgb)
{
    const size_t bytes = 3 * (size_t)width;
    unsigned char *rows = (unsigned char *)ex_new((size_t)height, bytes + 1);
    size_t y;
    for (y = 0; y < (size_t)height; ++y)
        ex_filter_row(rows + y * (bytes + 1), rgb + y * bytes, y ? rgb + (y - 1) * bytes : NULL,
                      bytes);
    ex_png_file(path, width, height, rows, bytes, NULL, 0);
    free(rows);
}

/* A palette: pixels sorted into 256 boxes. That with the largest squared distances from its mean is parted there, again
 * and again [Heckbert 1982]. */
typedef struct ex_box {
    size_t first, count; /* of the pixels' numbers */
    double mean[3], spread[3];
} ex_box;

EX_STATIC void ex_box_measure(ex_box *box, const unsigned char *rgb, const uint32_t *pixel)
{
    double sum[3] = {0, 0, 0}, square[3] = {0, 0, 0};
    size_t i;
    int k;
    for (i = box->first; i < box->first + box->count; ++i)
        for (k = 0; k < 3; ++k) {
            const double v = rgb[3 * (size_t)pixel[i] + (size_t)k];
            sum[k] += v;
            square[k] += v * v;
        }
    for (k = 0; k < 3; ++k) {
        box->mean[k] = sum[k] / (double)box->count;
        box->spread[k] = square[k] - sum[k] * box->mean[k];
    }
}

EX_STATIC ex_box ex_box_part(ex_box *box, const unsigned char *rgb, uint32_t *pixel)
{
    const int axis = box->spread[0] > box->spread[1] ? box->spread[0] > box->spread[2] ? 0 : 2
                     : box->spread[1] > box->spread[2] ? 1 : 2;
    size_t i = box->first, end = box->first + box->count;
    ex_box other = *box;
    while (i < end) {
        const uint32_t at = pixel[i];
        if (rgb[3 * (size_t)at + (size_t)axis] <= box->mean[axis]) {
            ++i;
            continue;
        }
        pixel[i] = pixel[--end];
        pixel[end] = at;
    }
    other.first = i;
    other.count = box->first + box->count - i;
    box->count = i - box->first;
    ex_box_measure(box, rgb, pixel);
    ex_box_measure(&other, rgb, pixel);
    return other;
}

/* In 256 colours: a third of the size, for pictures of few hues. */
EX_STATIC void ex_png_write_small(const char *path, int width, int height, const unsigned char *rgb)
{
    const size_t pixels = (size_t)width * (size_t)height;
    uint32_t *pixel = (uint32_t *)ex_new(pixels, sizeof *pixel);
    unsigned char *rows = (unsigned char *)ex_new((size_t)height, (size_t)width + 1), palette[3 * 256];
    ex_box box[256];
    int boxes = 1, k, c;
    size_t i;
    for (i = 0; i < pixels; ++i) pixel[i] = (uint32_t)i;
    box[0].first = 0;
    box[0].count = pixels;
    ex_box_measure(box, rgb, pixel);
    while (boxes < 256) {
        double most = 0.5;
        int widest = -1;
        for (k = 0; k < boxes; ++k) {
            const double s = fmax(box[k].spread[0], fmax(box[k].spread[1], box[k].spread[2]));
            if (s > most) most = s, widest = k;
        }
        if (widest < 0) break; /* every box has one colour */
        box[boxes] = ex_box_part(&box[widest], rgb, pixel);
        ++boxes;
    }
    for (k = 0; k < boxes; ++k) {
        for (c = 0; c < 3; ++c) palette[3 * k + c] = (unsigned char)(box[k].mean[c] + 0.5);
        for (i = box[k].first; i < box[k].first + box[k].count; ++i)
            rows[pixel[i] + pixel[i] / (uint32_t)width + 1] = (unsigned char)k;
    }
    ex_png_file(path, width, height, rows, (size_t)width, palette, boxes);
    free(pixel);
    free(rows);
}

/* --------------------------------------------------------------------------------------------
 * lettering: strokes on a grid, smooth at any size. Each pair of characters is a point x y in base
 * 36; baseline y = 3, lower case up to 9, capitals up to 12; ~ starts a quadratic B-spline.
 * -------------------------------------------------------------------------------------------- */

EX_STATIC const char *ex_glyph(char c)
{
    /* clang-format off */
    static const char *const glyph[95] = {
        "", "0c07 0303", "0c0a 2c2a", "2c13 5c43 0969 0666", "~6a6c0c0867630305 3d32",
        "6c03 ~1c2c2a0a0c1c ~556563434555", "~632a0c4c4a0807034367", "0c0a", "~3d0a0532",
        "~0d3a3502", "2b27 0a48 4a08", "3a34 0767", "1402", "0747", "0303", "025d",
        "~3c6c63030c3c", "0a2c23", "~0a0c6c6803 0363", "~0b0c6c6828 ~2868630305", "4c0666 4c43",
        "5c0c08 ~0869630305", "~060363690906 ~5c0b06", "0c6c23", "~3c5c58181c3c ~386863030838",
        "~696c0c066669 ~696413", "0808 0303", "1818 1402", "6a0764", "0969 0565", "0a6704",
        "~0a0c6c693835 3333", "~73030c8c8555 ~5a2a2555 5a55", "033c63 1656",
        "030c3c ~3c5c5838 0838 ~38686333 0333", "~6a6c0c036365", "030c2c ~2c6c6323 0323",
        "6c0c0363 0858", "6c0c03 0858", "~6a6c0c036367 6737", "0c03 6c63 0868", "0c03",
        "4c45 ~45430305", "0c03 6c07 2863", "0c0353", "030c468c83", "030c636c", "~080c7c730308",
        "030c3c ~3c6c6737 0737", "~080c7c730308 4572", "030c3c ~3c6c6737 0737 3763",
        "~6a6c0c0867630305", "0c6c 3c33", "0c06 ~06036366 666c", "0c336c", "0c234b638c",
        "0c63 6c03", "0c376c 3733", "0c6c0363", "2d0d0222", "0d52", "0d2d2202", "0a2c4a", "0262",
        "0c1a", "5953 ~565909035356", "0c03 ~060959530306", "~585909035354", "5c53 ~565909035356",
        "0656 ~565909035354", "~4c1c19 1913 0939", "~565909035356 5952 ~52500001",
        "0c03 ~06095956 5653", "0903 0c0c", "2922 ~222000 2c2c", "0c03 4905 2743", "0c03",
        "0903 ~06093936 3633 ~36396966 6663", "0903 ~06095956 5653", "~060959530306",
        "0900 ~060959530306", "5950 ~565909035356", "0903 ~060949", "~4849090646430304",
        "1b15 ~151333 0939", "0906 ~06035356 5953", "092349", "0923496389", "0943 4903",
        "0923 4910", "09490343", "~3d1d1807 ~07171232", "0d02", "~0d2d2837 ~37272202",
        "~0609356668"};
    /* clang-format on */
    return c > ' ' && c <= '~' ? glyph[c - ' '] : "";
}

EX_STATIC int ex_digit(char c) { return c <= '9' ? c - '0' : c - 'a' + 10; }

EX_STATIC double ex_advance(char c) /* in grid units, with the space behind */
{
    const char *s = ex_glyph(c);
    int widest = 2;
    if (*s) widest = 0;
    for (; *s; ++s) {
        if (*s == ' ' || *s == '~') continue;
        if (ex_digit(*s) > widest) widest = ex_digit(*s);
        ++s;
    }
    return widest + 2.8;
}

typedef struct ex_ink { /* coverage of a line of text, then blended once */
    int width, height;
    float *cover;
    double unit, x; /* pixels per grid unit; pen */
} ex_ink;

EX_STATIC void ex_ink_segment(ex_ink *ink, const double *a, const double *b)
{
    const double r = 0.62 * ink->unit + 0.2, u = ink->unit;
    const double ax = ink->x + u * a[0], ay = u * (14 - a[1]), bx = ink->x + u * b[0],
                 by = u * (14 - b[1]), dx = bx - ax, dy = by - ay, dd = dx * dx + dy * dy;
    const int x0 = (int)fmax(0, fmin(ax, bx) - r - 1), y0 = (int)fmax(0, fmin(ay, by) - r - 1);
    const int x1 = (int)fmin(ink->width - 1, fmax(ax, bx) + r + 1);
    const int y1 = (int)fmin(ink->height - 1, fmax(ay, by) + r + 1);
    int x, y;
    for (y = y0; y <= y1; ++y) {
        for (x = x0; x <= x1; ++x) {
            const double px = x + 0.5 - ax, py = y + 0.5 - ay;
            const double t = dd > 0 ? ex_clamp((px * dx + py * dy) / dd, 0, 1) : 0;
            const double c = 0.5 + r - hypot(px - t * dx, py - t * dy);
            float *p = &ink->cover[y * ink->width + x];
            if (c > (double)*p) *p = (float)ex_clamp(c, 0, 1);
        }
    }
}

EX_STATIC void ex_ink_curve(ex_ink *ink, double (*p)[2], int count)
{
    int i, k, axis;
    for (i = 1; i + 1 < count; ++i) {
        double from[2], to[2], last[2];
        for (axis = 0; axis < 2; ++axis) {
            from[axis] = i == 1 ? p[0][axis] : 0.5 * (p[i - 1][axis] + p[i][axis]);
            to[axis] = i + 2 == count ? p[i + 1][axis] : 0.5 * (p[i][axis] + p[i + 1][axis]);
            last[axis] = from[axis];
        }
        for (k = 1; k <= 6; ++k) {
            const double t = k / 6.0, s = 1 - t;
            double q[2];
            for (axis = 0; axis < 2; ++axis)
                q[axis] = s * s * from[axis] + 2 * s * t * p[i][axis] + t * t * to[axis];
            ex_ink_segment(ink, last, q);
            memcpy(last, q, sizeof last);
        }
    }
}

EX_STATIC void ex_ink_glyph(ex_ink *ink, char c)
{
    const char *s = ex_glyph(c);
    while (*s) {
        double p[12][2];
        const int curve = *s == '~';
        int i, count = 0;
        for (s += curve; *s && *s != ' ' && count < 12; s += 2, ++count) {
            p[count][0] = ex_digit(s[0]);
            p[count][1] = ex_digit(s[1]);
        }
        s += *s == ' ';
        if (curve)
            ex_ink_curve(ink, p, count);
        else
            for (i = 0; i + 1 < count; ++i) ex_ink_segment(ink, p[i], p[i + 1]);
    }
    ink->x += ink->unit * ex_advance(c);
}

EX_STATIC double ex_text_width(const char *text, double size)
{
    double width = -2.8;
    for (; *text; ++text) width += ex_advance(*text);
    return width * size / 9;
}

/* --------------------------------------------------------------------------------------------
 * pictures: one or several views of surfaces, each drawn at three times its size and averaged
 * -------------------------------------------------------------------------------------------- */

enum { EX_SAMPLES = 3, EX_SHADOW = 512 };

typedef struct ex_picture {
    int width, height;
    unsigned char *rgb;
    int up;        /* the axis that points up: 2 */
    double ground; /* its height along that axis; NAN: no ground */
    int bar;       /* 1 leaves room for a colour scale; set it before the first view */
    double sky[6]; /* sRGB behind everything, at the top and at the bottom; set it before the view */
    /* the view being drawn, in samples */
    int left, top, columns, rows;
    float *color;        /* [rows][columns][3], linear */
    float *near_inverse; /* 1/depth, 0 where nothing is */
    double eye[3], right[3], above[3], forward[3], light[3], centre[3];
    double focal, size, middle_x, middle_y, room;
    float *shadow; /* [EX_SHADOW][EX_SHADOW] of the ground around centre */
} ex_picture;

typedef struct ex_style {
    double color[3];  /* sRGB, where there are no values */
    double low, high; /* values at the ends of the colour scale */
    double edges;     /* how visible the triangles' edges are, 0..1 */
    int flat;         /* facets instead of a smooth surface */
} ex_style;

EX_STATIC ex_style ex_default_style(void)
{
    const ex_style s = {{0.42, 0.60, 0.78}, 0, 1, 0.35, 0};
    return s;
}

EX_STATIC double ex_dot(const double *a, const double *b)
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

EX_STATIC void ex_cross(const double *a, const double *b, double *c)
{
    c[0] = a[1] * b[2] - a[2] * b[1];
    c[1] = a[2] * b[0] - a[0] * b[2];
    c[2] = a[0] * b[1] - a[1] * b[0];
}

EX_STATIC void ex_unit(double *a)
{
    const double length = sqrt(ex_dot(a, a));
    int k;
    for (k = 0; k < 3; ++k) a[k] = length > 0 ? a[k] / length : 0;
}

/* Widens the box by n points; start with first = 1. */
EX_STATIC void ex_bounds(const double *x, long n, int first, double *lower, double *upper)
{
    long i;
    int k;
    for (i = 0; i < n; ++i) {
        for (k = 0; k < 3; ++k) {
            if ((first && i == 0) || x[3 * i + k] < lower[k]) lower[k] = x[3 * i + k];
            if ((first && i == 0) || x[3 * i + k] > upper[k]) upper[k] = x[3 * i + k];
        }
    }
}

EX_STATIC void ex_range(const double *value, long n, double *low, double *high)
{
    long i;
    *low = *high = n ? value[0] : 0;
    for (i = 1; i < n; ++i) {
        *low = fmin(*low, value[i]);
        *high = fmax(*high, value[i]);
    }
}

/* t in [0,1] to sRGB: from dark blue to yellow, evenly brighter, readable without colour vision */
EX_STATIC void ex_color_map(double t, double *rgb)
{
    static const double at[7][3] = {{0.27, 0.25, 0.56}, {0.22, 0.38, 0.65}, {0.16, 0.50, 0.67},
                                    {0.16, 0.62, 0.58}, {0.42, 0.75, 0.43}, {0.74, 0.83, 0.28},
                                    {0.99, 0.90, 0.32}};
    const double s = 6 * ex_clamp(t, 0, 1);
    const int i = s < 5 ? (int)s : 5;
    int k;
    for (k = 0; k < 3; ++k)
        rgb[k] = t == t ? at[i][k] + (s - i) * (at[i + 1][k] - at[i][k]) : 0.6; /* NaN: grey */
}

EX_STATIC ex_picture *ex_picture_new(int width, int height)
{
    static const double sky[6] = {0.985, 0.99, 1.0, 0.90, 0.92, 0.945};
    ex_picture *p = (ex_picture *)ex_new(1, sizeof *p);
    memcpy(p->sky, sky, sizeof sky);
    p->width = width;
    p->height = height;
    p->rgb = (unsigned char *)ex_new((size_t)width * (size_t)height, 3);
    memset(p->rgb, 255, 3 * (size_t)width * (size_t)height);
    p->up = 2;
    p->ground = NAN;
    return p;
}

EX_STATIC void ex_picture_free(ex_picture *p)
{
    free(p->rgb);
    free(p);
}

EX_STATIC void ex_blend(ex_picture *p, int x, int y, const double *rgb, double part)
{
    unsigned char *to;
    int k;
    if (x < 0 || y < 0 || x >= p->width || y >= p->height) return;
    to = p->rgb + 3 * ((size_t)y * (size_t)p->width + (size_t)x);
    for (k = 0; k < 3; ++k) to[k] = (unsigned char)(to[k] + part * (255 * rgb[k] - to[k]) + 0.5);
}

/* Text with capitals of `size` pixels; `align` of its width lies left of x; y is the baseline. */
EX_STATIC void ex_label(ex_picture *p, double x, double y, double size, double align,
                        const char *text)
{
    static const double dark[3] = {0.17, 0.20, 0.24};
    ex_ink ink;
    const double width = ex_text_width(text, size);
    const int left = (int)floor(x - align * width) - 2, top = (int)floor(y - 11 * size / 9);
    int i, k;
    ink.unit = size / 9;
    ink.width = (int)width + 8;
    ink.height = (int)(15 * ink.unit) + 2;
    ink.x = 2;
    ink.cover = (float *)ex_new((size_t)ink.width * (size_t)ink.height, sizeof *ink.cover);
    for (; *text; ++text) ex_ink_glyph(&ink, *text);
    for (i = 0; i < ink.height; ++i)
        for (k = 0; k < ink.width; ++k)
            ex_blend(p, left + k, top + i, dark, (double)ink.cover[i * ink.width + k]);
    free(ink.cover);
}

EX_STATIC double ex_bar_size(const ex_picture *p) /* of the colour scale's lettering */
{
    return ex_clamp(0.020 * (p->width < p->height ? p->width : p->height), 9, 18);
}

/* the eye so far back that the eight corners fill the view, and their middle in its middle */
EX_STATIC void ex_frame(ex_picture *p, const double *lower, const double *upper)
{
    const double fill_x = 0.42 * (p->columns - p->room), fill_y = 0.41 * p->rows;
    double low[2] = {0, 0}, high[2] = {0, 0}, away = 0;
    int corner, k, pass;
    for (pass = 0; pass < 2; ++pass) { /* 0: how far away, 1: where the middle is */
        for (corner = 0; corner < 8; ++corner) {
            double d[3], x, y, z;
            for (k = 0; k < 3; ++k) d[k] = (corner >> k & 1 ? upper[k] : lower[k]) - p->centre[k];
            x = ex_dot(d, p->right) * p->focal;
            y = ex_dot(d, p->above) * p->focal;
            z = ex_dot(d, p->forward);
            if (pass == 0) {
                away = fmax(away, fmax(fabs(x) / fill_x, fabs(y) / fill_y) - z);
                continue;
            }
            low[0] = corner ? fmin(low[0], x / (away + z)) : x / (away + z);
            high[0] = corner ? fmax(high[0], x / (away + z)) : x / (away + z);
            low[1] = corner ? fmin(low[1], y / (away + z)) : y / (away + z);
            high[1] = corner ? fmax(high[1], y / (away + z)) : y / (away + z);
        }
    }
    for (k = 0; k < 3; ++k) p->eye[k] = p->centre[k] - away * p->forward[k];
    p->middle_x = 0.5 * (p->columns - p->room) - 0.5 * (low[0] + high[0]);
    p->middle_y = 0.5 * p->rows + 0.5 * (low[1] + high[1]);
}

EX_STATIC void ex_background(ex_picture *p)
{
    int x, y, k;
    for (y = 0; y < p->rows; ++y) {
        const double t = (double)y / p->rows;
        for (x = 0; x < p->columns; ++x)
            for (k = 0; k < 3; ++k) {
                const double s = p->sky[k] + t * (p->sky[3 + k] - p->sky[k]);
                p->color[3 * (y * p->columns + x) + k] = (float)(s * s);
            }
    }
}

/* Starts view number `index` of across x down equal ones. The box is what has to be seen, direction
 * points from it to the eye. */
EX_STATIC void ex_view_begin(ex_picture *p, int index, int across, int down, const double *lower,
                             const double *upper, const double *direction)
{
    const int many = across * down > 1, strip = p->bar ? (int)(9 * ex_bar_size(p)) : 0;
    const int wide = many ? p->width - strip : p->width, gap = many ? 2 : 0;
    const int x0 = wide * (index % across) / across, y0 = p->height * (index / across) / down;
    const int x1 = wide * (index % across + 1) / across - gap;
    const int y1 = p->height * (index / across + 1) / down - gap;
    double d[3], up[3] = {0, 0, 0};
    size_t samples;
    int k;
    p->left = x0;
    p->top = y0;
    p->room = many ? 0 : EX_SAMPLES * strip;
    p->columns = EX_SAMPLES * (x1 - x0);
    p->rows = EX_SAMPLES * (y1 - y0);
    samples = (size_t)p->columns * (size_t)p->rows;
    p->color = (float *)ex_new(3 * samples, sizeof *p->color);
    p->near_inverse = (float *)ex_new(samples, sizeof *p->near_inverse);
    p->shadow = (float *)ex_new((size_t)EX_SHADOW * EX_SHADOW, sizeof *p->shadow);
    for (k = 0; k < 3; ++k) {
        p->forward[k] = -direction[k];
        p->centre[k] = 0.5 * (lower[k] + upper[k]);
        d[k] = upper[k] - lower[k];
    }
    p->size = sqrt(ex_dot(d, d));
    if (!(p->size > 0)) p->size = 1;
    up[p->up] = 1;
    ex_unit(p->forward);
    ex_cross(p->forward, up, p->right);
    if (ex_dot(p->right, p->right) < 1e-12) p->right[(p->up + 1) % 3] = 1; /* from straight above */
    ex_unit(p->right);
    ex_cross(p->right, p->forward, p->above);
    for (k = 0; k < 3; ++k)
        p->light[k] = 0.9 * up[k] - 0.55 * p->right[k] - 0.45 * p->forward[k] + 0.1 * p->above[k];
    ex_unit(p->light);
    p->focal = 1.9 * (p->columns < p->rows ? p->columns : p->rows); /* 30 degrees */
    ex_frame(p, lower, upper);
    ex_background(p);
}

/* x to samples and 1/depth; 0 if it lies behind the eye or far off, or is not a number */
EX_STATIC int ex_project(const ex_picture *p, const double *x, double *s)
{
    const double d[3] = {x[0] - p->eye[0], x[1] - p->eye[1], x[2] - p->eye[2]};
    const double z = ex_dot(d, p->forward);
    if (!(z > 1e-3 * p->size)) return 0;
    s[0] = p->middle_x + p->focal * ex_dot(d, p->right) / z;
    s[1] = p->middle_y - p->focal * ex_dot(d, p->above) / z;
    s[2] = 1 / z;
    return fabs(s[0]) < 1e6 && fabs(s[1]) < 1e6;
}

typedef struct ex_corner {
    double s[3];      /* where on the screen, 1/depth */
    double normal[3]; /* of length 1 */
    double color[3];  /* linear */
} ex_corner;

/* light from one side, the sky, the ground and a little from the eye */
EX_STATIC void ex_shade(const ex_picture *p, const double *normal, const double *color,
                        double darker, float *out)
{
    double n[3] = {normal[0], normal[1], normal[2]}, half[3], key, sky, gloss;
    int k;
    ex_unit(n);
    if (ex_dot(n, p->forward) > 0.15)
        for (k = 0; k < 3; ++k) n[k] = -n[k]; /* seen from inside */
    for (k = 0; k < 3; ++k) half[k] = p->light[k] - p->forward[k];
    ex_unit(half);
    key = fmax(0, ex_dot(n, p->light));
    sky = 0.5 + 0.5 * n[p->up];
    gloss = 0.10 * pow(fmax(0, ex_dot(n, half)), 36);
    for (k = 0; k < 3; ++k) {
        const double tint = k == 2 ? 1.04 : k == 0 ? 0.98 : 1; /* a cool sky */
        const double light =
            0.24 + 0.26 * sky * tint + 0.72 * key + 0.10 * fmax(0, -ex_dot(n, p->forward));
        out[k] = (float)fmin(1, (color[k] * light + gloss) * darker);
    }
}

/* which part of a sample's width, 0..1, is an edge's line of a triangle with the heights h */
EX_STATIC double ex_edge(const double *weight, const double *height, double visible)
{
    double near = 1e30, lowest = 1e30;
    int k;
    for (k = 0; k < 3; ++k) {
        near = fmin(near, weight[k] * height[k]);
        lowest = fmin(lowest, height[k]);
    }
    visible *= ex_clamp((lowest - 3.0 * EX_SAMPLES) / (8.0 * EX_SAMPLES), 0, 1); /* not if tiny */
    return visible * ex_clamp(0.5 + 0.45 * EX_SAMPLES - near, 0, 1);
}

EX_STATIC void ex_triangle(ex_picture *p, const ex_corner *c, double edges)
{
    const double *a = c[0].s, *b = c[1].s, *d = c[2].s;
    const double area = (b[0] - a[0]) * (d[1] - a[1]) - (b[1] - a[1]) * (d[0] - a[0]);
    const int x0 = (int)fmax(0, ceil(fmin(a[0], fmin(b[0], d[0])) - 0.5));
    const int y0 = (int)fmax(0, ceil(fmin(a[1], fmin(b[1], d[1])) - 0.5));
    const int x1 = (int)fmin(p->columns - 1, fmax(a[0], fmax(b[0], d[0])) - 0.5);
    const int y1 = (int)fmin(p->rows - 1, fmax(a[1], fmax(b[1], d[1])) - 0.5);
    double height[3];
    int x, y, i, k;
    if (fabs(area) < 1e-9) return;
    for (k = 0; k < 3; ++k) {
        const double *from = c[(k + 1) % 3].s, *to = c[(k + 2) % 3].s;
        height[k] = fabs(area) / hypot(to[0] - from[0], to[1] - from[1]);
    }
    for (y = y0; y <= y1; ++y) {
        for (x = x0; x <= x1; ++x) {
            const double px = x + 0.5, py = y + 0.5;
            double w[3], normal[3] = {0, 0, 0}, color[3] = {0, 0, 0}, inverse;
            const int at = y * p->columns + x;
            w[1] = ((px - a[0]) * (d[1] - a[1]) - (py - a[1]) * (d[0] - a[0])) / area;
            w[2] = ((b[0] - a[0]) * (py - a[1]) - (b[1] - a[1]) * (px - a[0])) / area;
            w[0] = 1 - w[1] - w[2];
            if (w[0] < 0 || w[1] < 0 || w[2] < 0) continue;
            inverse = w[0] * a[2] + w[1] * b[2] + w[2] * d[2];
            if (inverse <= (double)p->near_inverse[at]) continue;
            p->near_inverse[at] = (float)inverse;
            for (i = 0; i < 3; ++i) {
                const double share = w[i] * c[i].s[2] / inverse; /* perspective */
                for (k = 0; k < 3; ++k) {
                    normal[k] += share * c[i].normal[k];
                    color[k] += share * c[i].color[k];
                }
            }
            ex_shade(p, normal, color, 1 - 0.75 * ex_edge(w, height, edges), p->color + 3 * at);
        }
    }
}

/* the triangle's shadow on the ground, seen along the light */
EX_STATIC void ex_cast(ex_picture *p, double x[3][3])
{
    const int u = (p->up + 1) % 3, v = (p->up + 2) % 3;
    double s[3][2], area;
    int i, k, x0 = EX_SHADOW, x1 = -1, y0 = EX_SHADOW, y1 = -1;
    for (i = 0; i < 3; ++i) {
        const double t = (x[i][p->up] - p->ground) / p->light[p->up];
        s[i][0] = ((x[i][u] - t * p->light[u] - p->centre[u]) / (4 * p->size) + 0.5) * EX_SHADOW;
        s[i][1] = ((x[i][v] - t * p->light[v] - p->centre[v]) / (4 * p->size) + 0.5) * EX_SHADOW;
        for (k = 0; k < 2; ++k) s[i][k] = ex_clamp(s[i][k], 0, EX_SHADOW - 1);
        if ((int)s[i][0] < x0) x0 = (int)s[i][0];
        if ((int)s[i][0] > x1) x1 = (int)s[i][0];
        if ((int)s[i][1] < y0) y0 = (int)s[i][1];
        if ((int)s[i][1] > y1) y1 = (int)s[i][1];
    }
    area = (s[1][0] - s[0][0]) * (s[2][1] - s[0][1]) - (s[1][1] - s[0][1]) * (s[2][0] - s[0][0]);
    for (k = y0; k <= y1; ++k) {
        for (i = x0; i <= x1; ++i) {
            const double px = i + 0.5 - s[0][0], py = k + 0.5 - s[0][1];
            const double w1 = px * (s[2][1] - s[0][1]) - py * (s[2][0] - s[0][0]);
            const double w2 = (s[1][0] - s[0][0]) * py - (s[1][1] - s[0][1]) * px;
            const double e = -0.05 * fabs(area), side = area < 0 ? -1 : 1;
            if (w1 * side < e || w2 * side < e || (area - w1 - w2) * side < e) continue;
            p->shadow[k * EX_SHADOW + i] = 1;
        }
    }
}

/* for every corner the mean normal of those triangles at the node that bend less than 40 degrees */
EX_STATIC double *ex_corner_normals(long nodes, const double *x, long triangles, const int32_t *tri,
                                    int flat)
{
    double *face = (double *)ex_new((size_t)triangles, 3 * sizeof *face); /* twice the area long */
    double *out = (double *)ex_new((size_t)triangles, 9 * sizeof *out);
    long *first = (long *)ex_new((size_t)nodes + 2, sizeof *first), t, j;
    long *user = (long *)ex_new((size_t)triangles * 3, sizeof *user);
    int i, k;
    for (t = 0; t < triangles; ++t) {
        double u[3], v[3];
        for (k = 0; k < 3; ++k) {
            u[k] = x[3 * tri[3 * t + 1] + k] - x[3 * tri[3 * t] + k];
            v[k] = x[3 * tri[3 * t + 2] + k] - x[3 * tri[3 * t] + k];
        }
        ex_cross(u, v, face + 3 * t);
        for (i = 0; i < 3; ++i) ++first[tri[3 * t + i] + 2];
    }
    for (j = 0; j < nodes; ++j) first[j + 2] += first[j + 1];
    for (t = 0; t < 3 * triangles; ++t) user[first[tri[t] + 1]++] = t / 3;
    for (t = 0; t < 3 * triangles; ++t) {
        const double *own = face + 3 * (t / 3);
        for (j = first[tri[t]]; j < first[tri[t] + 1]; ++j) {
            const double *f = face + 3 * user[j], lengths = ex_dot(f, f) * ex_dot(own, own);
            if (user[j] != t / 3 && (flat || ex_dot(f, own) < 0.766 * sqrt(lengths))) continue;
            for (k = 0; k < 3; ++k) out[3 * t + k] += f[k];
        }
        ex_unit(out + 3 * t);
    }
    free(face);
    free(first);
    free(user);
    return out;
}

/* Draws the triangles, coloured by value [nodes], or by the style's colour if that is NULL. */
EX_STATIC void ex_view_surface(ex_picture *p, long nodes, const double *x, long triangles,
                               const int32_t *tri, const double *value, const ex_style *style)
{
    double *normal = ex_corner_normals(nodes, x, triangles, tri, style->flat);
    const double span = ex_apart(style->low, style->high) ? style->high - style->low : 1;
    long t;
    int i, k;
    for (t = 0; t < triangles; ++t) {
        ex_corner c[3];
        double at[3][3];
        int seen = 1;
        for (i = 0; i < 3; ++i) {
            const int32_t node = tri[3 * t + i];
            memcpy(at[i], x + 3 * node, sizeof at[i]);
            memcpy(c[i].normal, normal + 9 * t + 3 * i, sizeof c[i].normal);
            memcpy(c[i].color, style->color, sizeof c[i].color);
            if (value) ex_color_map((value[node] - style->low) / span, c[i].color);
            for (k = 0; k < 3; ++k) c[i].color[k] *= c[i].color[k];
            seen = seen && ex_project(p, at[i], c[i].s);
        }
        if (seen) ex_triangle(p, c, style->edges);
        if (seen && p->ground == p->ground) ex_cast(p, at);
    }
    free(normal);
}

/* A line from a to b, width in pixels, in front of what is behind it; a = b gives a dot. */
EX_STATIC void ex_view_line(ex_picture *p, const double *a, const double *b, double width,
                            const double *color)
{
    double s[3], e[3], dx, dy, dd;
    const double r = 0.5 * EX_SAMPLES * width;
    int x, y, k;
    if (!ex_project(p, a, s) || !ex_project(p, b, e)) return;
    dx = e[0] - s[0];
    dy = e[1] - s[1];
    dd = dx * dx + dy * dy;
    for (y = (int)fmax(0, fmin(s[1], e[1]) - r); y < fmin(p->rows, fmax(s[1], e[1]) + r); ++y) {
        for (x = (int)fmax(0, fmin(s[0], e[0]) - r); x < fmin(p->columns, fmax(s[0], e[0]) + r);
             ++x) {
            const double px = x + 0.5 - s[0], py = y + 0.5 - s[1];
            const double t = dd > 0 ? ex_clamp((px * dx + py * dy) / dd, 0, 1) : 0;
            const double inverse = (s[2] + t * (e[2] - s[2])) * 1.004; /* not sunk in a surface */
            const int at = y * p->columns + x;
            if (hypot(px - t * dx, py - t * dy) > r || inverse < (double)p->near_inverse[at])
                continue;
            p->near_inverse[at] = (float)inverse;
            for (k = 0; k < 3; ++k) p->color[3 * at + k] = (float)(color[k] * color[k]);
        }
    }
}

EX_STATIC void ex_blur(float *image, int size, int radius) /* once along rows, then turned over */
{
    float *out = (float *)ex_new((size_t)size * (size_t)size, sizeof *out);
    int x, y, k;
    for (y = 0; y < size; ++y) {
        double sum = 0;
        for (k = 0; k < radius; ++k) sum += (double)image[y * size + k];
        for (x = 0; x < size; ++x) {
            if (x + radius < size) sum += (double)image[y * size + x + radius];
            if (x - radius > 0) sum -= (double)image[y * size + x - radius - 1];
            out[x * size + y] = (float)(sum / (2 * radius + 1));
        }
    }
    memcpy(image, out, (size_t)size * (size_t)size * sizeof *out);
    free(out);
}

/* a plane that fades away, with a grid and the shadows */
EX_STATIC void ex_ground(ex_picture *p)
{
    const int u = (p->up + 1) % 3, v = (p->up + 2) % 3;
    const double step = ex_nice(p->size / 6);
    int x, y, k, pass;
    for (pass = 0; pass < 4; ++pass) ex_blur(p->shadow, EX_SHADOW, 3);
    for (y = 0; y < p->rows; ++y) {
        for (x = 0; x < p->columns; ++x) {
            const double sx = (x + 0.5 - p->middle_x) / p->focal,
                         sy = (p->middle_y - y - 0.5) / p->focal;
            const int at = y * p->columns + x;
            double ray[3], t, gu, gv, fade, line, shade, width;
            int i, j;
            for (k = 0; k < 3; ++k) ray[k] = p->forward[k] + sx * p->right[k] + sy * p->above[k];
            t = (p->ground - p->eye[p->up]) / ray[p->up]; /* the depth */
            if (!(t > 0) || 1 / t <= (double)p->near_inverse[at]) continue;
            gu = p->eye[u] + t * ray[u];
            gv = p->eye[v] + t * ray[v];
            fade = hypot(gu - p->centre[u], gv - p->centre[v]) / (1.6 * p->size);
            if (fade >= 1) continue;
            fade = (1 - fade * fade) * (1 - fade * fade);
            width = 0.7 * EX_SAMPLES * t / p->focal;
            line = fabs(gu - step * floor(gu / step + 0.5)) < width ||
                   fabs(gv - step * floor(gv / step + 0.5)) < width;
            i = (int)(((gu - p->centre[u]) / (4 * p->size) + 0.5) * EX_SHADOW);
            j = (int)(((gv - p->centre[v]) / (4 * p->size) + 0.5) * EX_SHADOW);
            shade = i >= 0 && j >= 0 && i < EX_SHADOW && j < EX_SHADOW
                        ? (double)p->shadow[j * EX_SHADOW + i]
                        : 0;
            p->near_inverse[at] = (float)(1 / t);
            for (k = 0; k < 3; ++k)
                p->color[3 * at + k] *= (float)(1 - fade * (0.10 + 0.16 * line + 0.42 * shade));
        }
    }
}

/* Darkens hollows. Along a plane 1/depth is linear on the screen, so a mean of two opposite
 * neighbours above the middle tells that these are nearer than a plane would be. */
EX_STATIC void ex_hollows(ex_picture *p)
{
    enum {
        LOOKS = 6,
        TURNS = EX_SAMPLES * EX_SAMPLES
    }; /* samples of a pixel look different ways */
    const size_t samples = (size_t)p->columns * (size_t)p->rows;
    const double reach = 0.07 * p->size;
    float *dark = (float *)ex_new(samples, sizeof *dark);
    double way[TURNS][LOOKS][2];
    size_t i;
    int x, y, k;
    for (y = 0; y < TURNS; ++y) {
        for (k = 0; k < LOOKS; ++k) {
            const double angle = 3.14159265 * (7 * y % TURNS / (double)TURNS + 0.618 * k);
            way[y][k][0] = cos(angle) * (k + 1) / LOOKS;
            way[y][k][1] = sin(angle) * (k + 1) / LOOKS;
        }
    }
    for (y = 0; y < p->rows; ++y) {
        for (x = 0; x < p->columns; ++x) {
            const int at = y * p->columns + x,
                      turn = x % EX_SAMPLES + EX_SAMPLES * (y % EX_SAMPLES);
            const double w = (double)p->near_inverse[at], pixels = reach * p->focal * w;
            double sum = 0;
            for (k = 0; w > 0 && k < LOOKS; ++k) {
                const int dx = (int)(pixels * way[turn][k][0]),
                          dy = (int)(pixels * way[turn][k][1]);
                const int out = abs(dx) > x || abs(dx) >= p->columns - x || abs(dy) > y ||
                                abs(dy) >= p->rows - y;
                const int step = dy * p->columns + dx;
                double rise;
                if (out) continue;
                rise = 0.5 * (double)(p->near_inverse[at + step] + p->near_inverse[at - step]) - w;
                rise /= w * w; /* metres */
                if (rise < 1.5 * reach)
                    sum += ex_clamp(2.2 * LOOKS * rise / (reach * (k + 1)), 0, 1);
            }
            dark[at] = (float)(sum / LOOKS);
        }
    }
    for (i = 0; i < samples; ++i)
        for (k = 0; k < 3; ++k) p->color[3 * i + (size_t)k] *= (float)(1 - 0.6 * (double)dark[i]);
    free(dark);
}

/* Finishes the view: ground, hollows, the mean of the samples, a caption (or NULL). */
EX_STATIC void ex_view_end(ex_picture *p, const char *caption)
{
    const int wide = p->columns / EX_SAMPLES, high = p->rows / EX_SAMPLES;
    const double size = ex_clamp(0.022 * (wide < high ? wide : high), 9, 20);
    int x, y, i, j, k;
    if (p->ground == p->ground) ex_ground(p);
    ex_hollows(p);
    for (y = 0; y < high; ++y) {
        for (x = 0; x < wide; ++x) {
            double rgb[3] = {0, 0, 0};
            for (j = 0; j < EX_SAMPLES; ++j)
                for (i = 0; i < EX_SAMPLES; ++i)
                    for (k = 0; k < 3; ++k)
                        rgb[k] += sqrt((double)p->color[3 * ((EX_SAMPLES * y + j) * p->columns +
                                                             EX_SAMPLES * x + i) +
                                                        k]);
            for (k = 0; k < 3; ++k) rgb[k] /= EX_SAMPLES * EX_SAMPLES;
            ex_blend(p, p->left + x, p->top + y, rgb, 1);
        }
    }
    if (caption) ex_label(p, p->left + 2 * size, p->top + 3 * size, size, 0, caption);
    free(p->color);
    free(p->near_inverse);
    free(p->shadow);
}

/* The colour scale at the picture's right edge. */
EX_STATIC void ex_colorbar(ex_picture *p, const char *label, double low, double high)
{
    const double size = ex_bar_size(p);
    const int tall = (int)(0.5 * p->height), wide = (int)(1.4 * size);
    const int x0 = p->width - (int)(9 * size), y0 = (p->height - tall) / 2;
    const double span = ex_apart(low, high) ? high - low : 1, step = ex_nice(span / 6);
    static const double ink[3] = {0.17, 0.20, 0.24};
    double tick;
    int x, y;
    for (y = 0; y < tall; ++y) {
        double rgb[3];
        ex_color_map(1 - (y + 0.5) / tall, rgb);
        for (x = 0; x < wide; ++x) ex_blend(p, x0 + x, y0 + y, rgb, 1);
    }
    tick = step * ceil(low / step - 1e-9);
    for (; ex_apart(low, high) && tick <= high + 1e-9 * span; tick += step) {
        char text[32];
        const int at = y0 + (int)((1 - (tick - low) / span) * (tall - 1));
        ex_short(text, sizeof text, tick, span);
        for (x = 0; x < size / 2; ++x) ex_blend(p, x0 + wide + x, at, ink, 0.8);
        ex_label(p, x0 + wide + size, at + 0.45 * size, 0.85 * size, 0, text);
    }
    ex_label(p, p->width - 2 * size, y0 - 1.3 * size, 0.9 * size, 1, label);
}

EX_STATIC void ex_picture_write(const ex_picture *p, const char *path)
{
    ex_png_write(path, p->width, p->height, p->rgb);
}

EX_STATIC void ex_picture_write_small(const ex_picture *p, const char *path) /* in 256 colours */
{
    ex_png_write_small(path, p->width, p->height, p->rgb);
}

#endif
