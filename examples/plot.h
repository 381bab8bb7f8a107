/* plot.h - lines and markers over linear or logarithmic axes as .svg. Included by support.h.
 *
 *     ex_plot p = ex_plot_new("Error against step", "h, s", "relative error", EX_LOG_X | EX_LOG_Y);
 *     ex_plot_add(&p, "p = 1/4", x, y, count, EX_LINE | EX_MARKERS);
 *     ex_plot_write(&p, "error.svg");
 *
 * What cannot be drawn (NaN, or <= 0 on a logarithmic axis) leaves a gap. Colors and markers go by the order
 * of the series, unless ex_plot_look gives the last one its own. ex_plots_write draws several beside and
 * below one another, with the legend of the first.
 */
#ifndef SFEM_EXAMPLES_PLOT_H
#define SFEM_EXAMPLES_PLOT_H

/* --------------------------------------------------------------------------------------------
 * plots as .svg
 * -------------------------------------------------------------------------------------------- */

enum { EX_SERIES = 32, EX_COLORS = 12, EX_LOG_X = 1, EX_LOG_Y = 2 };
enum {
    EX_LINE = 1,
    EX_MARKERS = 2,
    EX_DASHED = 4,
    EX_THICK = 8,
    EX_BAND = 16
}; /* band: wide and pale */

typedef struct ex_series {
    const char *name;    /* in the legend, or NULL */
    const double *x, *y; /* the caller's, kept until the plot is written */
    long count;
    int style;         /* EX_LINE, EX_MARKERS, EX_DASHED, EX_THICK, EX_BAND, added */
    int marker;        /* 0 .. 7: disc, square, triangle, diamond, the same hollow */
    const char *color; /* "#2563a8" */
} ex_series;

typedef struct ex_axis {
    const char *label;
    int log;
    double low, high; /* in log10 if log */
    double from, to;  /* pixels */
} ex_axis;

typedef struct ex_plot {
    const char *title;
    ex_axis x, y;
    int count;
    ex_series series[EX_SERIES];
} ex_plot;

EX_STATIC ex_plot ex_plot_new(const char *title, const char *x_label, const char *y_label, int logs)
{
    ex_plot p;
    memset(&p, 0, sizeof p);
    p.title = title;
    p.x.label = x_label;
    p.y.label = y_label;
    p.x.log = (logs & EX_LOG_X) != 0;
    p.y.log = (logs & EX_LOG_Y) != 0;
    return p;
}

EX_STATIC void ex_plot_add(ex_plot *p, const char *name, const double *x, const double *y,
                           long count, int style)
{
    static const char *const color[EX_COLORS] = {"#2563a8", "#d1603d", "#3f8f5b", "#8a5aa8",
                                                 "#b8892b", "#3a9aa5", "#b04668", "#6b7683",
                                                 "#1b3a5c", "#7a3520", "#5d9c2f", "#4d4d4d"};
    ex_series *s = &p->series[p->count];
    if (p->count == EX_SERIES) ex_fail("%s: too many series", p->title);
    s->color = color[p->count % EX_COLORS];
    s->marker = p->count++ % 4;
    s->name = name;
    s->x = x;
    s->y = y;
    s->count = count;
    s->style = style;
}

EX_STATIC void ex_plot_look(ex_plot *p, const char *color, int marker) /* of the last series */
{
    p->series[p->count - 1].color = color;
    p->series[p->count - 1].marker = marker;
}

EX_STATIC double ex_axis_value(const ex_axis *a, double value) /* not finite: cannot be drawn */
{
    return !a->log ? value : value > 0 ? log10(value) : NAN;
}

EX_STATIC double ex_axis_pixel(const ex_axis *a, double value)
{
    return a->from + (ex_axis_value(a, value) - a->low) / (a->high - a->low) * (a->to - a->from);
}

EX_STATIC void ex_axis_fit(ex_axis *a, const ex_plot *p, int is_y)
{
    double margin;
    long i;
    int s;
    a->low = 1e300;
    a->high = -1e300;
    for (s = 0; s < p->count; ++s) {
        for (i = 0; i < p->series[s].count; ++i) {
            const double v = ex_axis_value(a, is_y ? p->series[s].y[i] : p->series[s].x[i]);
            if (!isfinite(v)) continue;
            a->low = fmin(a->low, v);
            a->high = fmax(a->high, v);
        }
    }
    if (a->low > a->high) a->low = 0, a->high = 1;
    margin = is_y || a->log ? 0.05 * (a->high - a->low) : 0;
    if (!ex_apart(a->low, a->high)) margin = a->low != 0 ? 0.1 * fabs(a->low) : 1;
    a->low -= margin;
    a->high += margin;
}

EX_STATIC void ex_svg_text(FILE *f, const char *text)
{
    for (; *text; ++text) {
        if (*text == '<')
            fputs("&lt;", f);
        else if (*text == '>')
            fputs("&gt;", f);
        else if (*text == '&')
            fputs("&amp;", f);
        else
            fputc(*text, f);
    }
}

EX_STATIC void ex_svg_tick(FILE *f, const ex_axis *a, const ex_axis *other, int is_y, double value,
                           int labelled)
{
    const double at = ex_axis_pixel(a, value);
    const char *grid = labelled ? "#dde2e7" : "#eef1f4";
    const int power = a->log && (a->low < -3.01 || a->high > 4.01);
    char text[32];
    if (!(at >= fmin(a->from, a->to) - 0.01 && at <= fmax(a->from, a->to) + 0.01)) return;
    if (is_y)
        fprintf(f, "<path d='M%.1f %.1fH%.1f' stroke='%s'/>\n", other->from, at, other->to, grid);
    else
        fprintf(f, "<path d='M%.1f %.1fV%.1f' stroke='%s'/>\n", at, other->from, other->to, grid);
    if (!labelled) return;
    if (is_y)
        fprintf(f, "<text x='%.1f' y='%.1f' text-anchor='end'>", other->from - 8, at + 4.5);
    else
        fprintf(f, "<text x='%.1f' y='%.1f' text-anchor='middle'>", at, other->from + 20);
    ex_short(text, sizeof text, value, a->log ? 0 : a->high - a->low);
    if (power)
        fprintf(f, "10<tspan dy='-5' font-size='10'>%.0f</tspan></text>\n", log10(value));
    else if (a->log)
        fprintf(f, "%g</text>\n", value);
    else
        fprintf(f, "%s</text>\n", text);
}

EX_STATIC void ex_svg_axis(FILE *f, const ex_axis *a, const ex_axis *other, int is_y)
{
    const double decades = a->high - a->low, step = ex_nice(decades / (is_y ? 6 : 8));
    double tick;
    int k, skip = decades > 10 ? (int)ceil(decades / 10) : 1;
    if (!a->log) {
        for (tick = step * ceil(a->low / step - 1e-9); tick <= a->high + 1e-9 * step; tick += step)
            ex_svg_tick(f, a, other, is_y, tick, 1);
    } else {
        for (k = 2; decades <= 5 && k < 10;
             ++k) /* the lines between first, so that they lie below */
            for (tick = floor(a->low); tick <= a->high; ++tick)
                ex_svg_tick(f, a, other, is_y, k * pow(10, tick),
                            decades < 2.5 && a->low > -3 && a->high < 4 && (k == 2 || k == 5));
        for (tick = floor(a->low); tick <= a->high; ++tick)
            ex_svg_tick(f, a, other, is_y, pow(10, tick), (int)tick % skip == 0);
    }
    if (is_y)
        fprintf(f,
                "<text transform='translate(20 %.1f) rotate(-90)' text-anchor='middle' "
                "fill='#2b333b'>",
                0.5 * (a->from + a->to));
    else
        fprintf(f, "<text x='%.1f' y='%.1f' text-anchor='middle' fill='#2b333b'>",
                0.5 * (a->from + a->to), other->from + 44);
    ex_svg_text(f, a->label);
    fprintf(f, "</text>\n");
}

EX_STATIC void ex_svg_marker(FILE *f, int kind, double x, double y, const char *color)
{
    switch (kind % 4) {
    case 0:
        fprintf(f, "<circle cx='%.1f' cy='%.1f' r='3.6'", x, y);
        break;
    case 1:
        fprintf(f, "<path d='M%.1f %.1fh6.4v6.4h-6.4z'", x - 3.2, y - 3.2);
        break;
    case 2:
        fprintf(f, "<path d='M%.1f %.1fl4.2 7.2h-8.4z'", x, y - 4.6);
        break;
    default:
        fprintf(f, "<path d='M%.1f %.1fl4.6 4.6l-4.6 4.6l-4.6 -4.6z'", x, y - 4.6);
        break;
    }
    if (kind < 4)
        fprintf(f, " fill='%s' stroke='#fff' stroke-width='1.2'/>\n", color);
    else
        fprintf(f, " fill='#fff' stroke='%s' stroke-width='1.6'/>\n", color);
}

EX_STATIC void ex_svg_stroke(FILE *f, const ex_series *s)
{
    const int width = s->style & EX_BAND ? 12 : s->style & EX_THICK ? 4 : 2;
    fprintf(f, "stroke='%s' stroke-width='%d' stroke-linejoin='round'%s%s", s->color, width,
            s->style & EX_BAND ? " opacity='.22'" : "",
            s->style & EX_DASHED ? " stroke-dasharray='7 5'" : "");
}

/* A long series is thinned to its lowest and highest points in each of about 1000 stretches. */
EX_STATIC void ex_svg_series(FILE *f, const ex_plot *p, const ex_series *s)
{
    const long chunk = s->count > 4000 ? s->count / 1000 : 1;
    long i, k, n;
    int pen = 0;
    if (s->style & EX_LINE) {
        fprintf(f, "<path fill='none' ");
        ex_svg_stroke(f, s);
        fprintf(f, " d='");
        for (i = 0; i < s->count; i += chunk) {
            long pick[2];
            pick[0] = pick[1] = i;
            for (k = i; k < i + chunk && k < s->count; ++k) {
                if (s->y[k] < s->y[pick[0]]) pick[0] = k;
                if (s->y[k] > s->y[pick[1]]) pick[1] = k;
            }
            if (pick[0] > pick[1]) k = pick[0], pick[0] = pick[1], pick[1] = k;
            for (n = 0; n < (pick[0] == pick[1] ? 1 : 2); ++n) {
                const double x = ex_axis_pixel(&p->x, s->x[pick[n]]);
                const double y = ex_axis_pixel(&p->y, s->y[pick[n]]);
                const int drawn = isfinite(x) && isfinite(y);
                if (drawn) fprintf(f, "%c%.1f %.1f", pen ? 'L' : 'M', x, y);
                pen = drawn;
            }
        }
        fprintf(f, "'/>\n");
    }
    for (i = 0; s->style & EX_MARKERS && i < s->count; ++i) {
        const double x = ex_axis_pixel(&p->x, s->x[i]), y = ex_axis_pixel(&p->y, s->y[i]);
        if (isfinite(x) && isfinite(y)) ex_svg_marker(f, s->marker, x, y, s->color);
    }
}

EX_STATIC void ex_svg_begin(FILE *f, int width, int height)
{
    fprintf(f,
            "<svg xmlns='http://www.w3.org/2000/svg' width='%d' height='%d' viewBox='0 0 %d %d' "
            "font-family='Helvetica, Arial, sans-serif' font-size='13' fill='#55606b'>\n"
            "<rect width='%d' height='%d' fill='#fff'/>\n",
            width, height, width, height, width, height);
}

EX_STATIC void ex_svg_panel(FILE *f, ex_plot *p) /* in 712 x 480 */
{
    int s;
    ex_axis_fit(&p->x, p, 0);
    ex_axis_fit(&p->y, p, 1);
    p->x.from = 84;
    p->x.to = 684;
    p->y.from = 420;
    p->y.to = 56;
    fprintf(f, "<text x='84' y='34' font-size='17' font-weight='bold' fill='#2b333b'>");
    ex_svg_text(f, p->title);
    fprintf(f, "</text>\n");
    ex_svg_axis(f, &p->x, &p->y, 0);
    ex_svg_axis(f, &p->y, &p->x, 1);
    fprintf(f, "<path d='M84 56V420H684' fill='none' stroke='#8a949e'/>\n");
    for (s = 0; s < p->count; ++s) ex_svg_series(f, p, &p->series[s]);
}

EX_STATIC int ex_legend_width(const ex_plot *p) /* 0: none */
{
    size_t longest = 0;
    int s;
    for (s = 0; s < p->count; ++s)
        if (p->series[s].name && strlen(p->series[s].name) > longest)
            longest = strlen(p->series[s].name);
    return longest ? 28 + 8 * (int)longest : 0;
}

EX_STATIC void ex_svg_legend(FILE *f, const ex_plot *p)
{
    double y = 66;
    int s;
    for (s = 0; s < p->count; ++s) {
        if (!p->series[s].name) continue;
        if (p->series[s].style & EX_LINE) {
            fprintf(f, "<path d='M698 %.1fh24' ", y);
            ex_svg_stroke(f, &p->series[s]);
            fprintf(f, "/>\n");
        }
        if (p->series[s].style & EX_MARKERS)
            ex_svg_marker(f, p->series[s].marker, 710, y, p->series[s].color);
        fprintf(f, "<text x='730' y='%.1f' fill='#2b333b'>", y + 4.5);
        ex_svg_text(f, p->series[s].name);
        fprintf(f, "</text>\n");
        y += 22;
    }
}

EX_STATIC void ex_plots_write(ex_plot *p, int count, int columns, const char *path)
{
    FILE *f = ex_open(path);
    const int rows = (count + columns - 1) / columns, legend = 66 + 22 * p->count;
    const int high = 480 * rows > legend ? 480 * rows : legend;
    int i;
    ex_svg_begin(f, 712 * columns + ex_legend_width(p), high);
    for (i = 0; i < count; ++i) {
        fprintf(f, "<g transform='translate(%d %d)'>\n", 712 * (i % columns), 480 * (i / columns));
        ex_svg_panel(f, p + i);
        fprintf(f, "</g>\n");
    }
    fprintf(f, "<g transform='translate(%d 0)'>\n", 712 * (columns - 1));
    ex_svg_legend(f, p);
    fprintf(f, "</g>\n</svg>\n");
    ex_close(f, path);
}

EX_STATIC void ex_plot_write(ex_plot *p, const char *path) { ex_plots_write(p, 1, 1, path); }

#endif
