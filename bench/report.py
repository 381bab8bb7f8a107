#!/usr/bin/env python3
"""Makes one page of what `make bench` measured: DIR/report.html, self-contained, light and dark.

    python3 bench/report.py DIR INTEGRATORS.csv [quick]

Reads what the benches printed, DIR/{bench,solver,eigen,needs}.txt, DIR/needs.csv and integrators.csv. What is missing
is left out of the page, with the command that makes it. Standard library only.
"""
import csv
import datetime
import html
import math
import os
import re
import sys

CSS = """
:root { color-scheme: light dark; --page: #fbfbfa; --card: #fff; --ink: #1d232a; --soft: #5b6670; --line: #dfe3e7;
  --grid: #e9ecef; --dot: #b3bac2; --s0: #2563a8; --s1: #4aa3df; --s2: #3f8f5b; --s3: #d1603d; --s4: #b8892b;
  --s5: #b04668; --s6: #8a5aa8; --s7: #7b9a1e; --good: #2c7a4b; --bad: #b3472b; --front: #f3e2ab; --bar: #b9d0ea; --bar2: #2563a8; }
@media (prefers-color-scheme: dark) { :root { --page: #14171b; --card: #1b1f25; --ink: #e6e9ec; --soft: #9aa5b0;
  --line: #30363d; --grid: #272c33; --dot: #59626c; --s0: #6aa9f0; --s1: #8fd0ff; --s2: #66c088; --s3: #f08c66;
  --s4: #dcb35c; --s5: #e57f9e; --s6: #bd92da; --s7: #b0cf52; --good: #6fce93; --bad: #f08c66; --front: #5c5228; --bar: #35506f;
  --bar2: #6aa9f0; } }
* { box-sizing: border-box; }
body { margin: 0; background: var(--page); color: var(--ink); font: 15px/1.5 system-ui, -apple-system, "Segoe UI",
  Helvetica, Arial, sans-serif; }
main { max-width: 1240px; margin: 0 auto; padding: 28px 20px 60px; }
h1 { font-size: 26px; margin: 0 0 2px; } h2 { font-size: 19px; margin: 42px 0 4px; } h3 { font-size: 14px; margin: 0 0 4px; }
p { margin: 4px 0 12px; max-width: 78ch; color: var(--soft); } p b, td b { color: var(--ink); }
.tiles, .plots { display: grid; gap: 12px; }
.tiles { grid-template-columns: repeat(auto-fit, minmax(150px, 1fr)); margin: 18px 0 0; }
.plots { grid-template-columns: repeat(auto-fill, minmax(min(100%, 370px), 1fr)); }
.card { background: var(--card); border: 1px solid var(--line); border-radius: 8px; padding: 12px 14px; min-width: 0; }
.tile b { display: block; font-size: 20px; font-variant-numeric: tabular-nums; line-height: 1.3; }
.tile span { color: var(--soft); font-size: 13px; }
svg { display: block; width: 100%; height: auto; font: 12px system-ui, -apple-system, Helvetica, Arial, sans-serif; }
svg text { fill: var(--soft); } .axis { stroke: var(--line); } .grid { stroke: var(--grid); }
.scroll { overflow-x: auto; } table { border-collapse: collapse; font-variant-numeric: tabular-nums; font-size: 14px;
  width: 100%; } th, td { padding: 4px 10px; text-align: right; border-bottom: 1px solid var(--grid); white-space: nowrap; }
th { font-weight: 600; color: var(--soft); font-size: 13px; vertical-align: bottom; }
th:first-child, td:first-child, .text { text-align: left; }
.legend { display: flex; flex-wrap: wrap; gap: 4px 16px; margin: 6px 0 12px; font-size: 13px; color: var(--soft); }
.legend i { display: inline-block; width: 18px; height: 3px; border-radius: 2px; vertical-align: middle; margin-right: 6px; }
.good { color: var(--good); } .bad { color: var(--bad); }
details { margin: 10px 0; } summary { cursor: pointer; color: var(--soft); }
pre { overflow-x: auto; font: 12px/1.45 ui-monospace, Menlo, Consolas, monospace; background: var(--card);
  border: 1px solid var(--line); border-radius: 8px; padding: 12px; }
code { font: 13px ui-monospace, Menlo, Consolas, monospace; }
.pairs td:first-child { white-space: normal; min-width: 150px; } .pairs small { display: block; color: var(--soft); }
.pair { display: grid; gap: 2px; width: 150px; } .pair i { display: block; height: 7px; border-radius: 2px; min-width: 1px; }
@media (max-width: 560px) { main { padding: 18px 12px 40px; } h1 { font-size: 22px; }
  .tiles { grid-template-columns: 1fr 1fr; } .card { padding: 10px; } th, td { padding: 4px 6px; font-size: 13px; }
  th { white-space: normal; } .pair { width: 56px; } }
"""

# What is drawn as a line in run time against error, and how; the others are dots that say their name.
LINES = [
    ('default', 'default: (p,q,r), corrected', 's0', 3.2, ''),
    ('accuracy 1: one solve', 'one solve a step', 's1', 2.2, ''),
    ('central difference', 'central difference', 's2', 2, ''),
    ('Newmark, Newton to 1e-8', 'Newmark, Newton to 1e-8', 's3', 2, ''),
    ('Newmark, Newton to 1e-3', 'Newmark, Newton to 1e-3', 's3', 1.6, '5 4'),
    ('Newmark, semi-implicit', 'Newmark, semi-implicit', 's4', 2, ''),
    ('backward Euler, 1 iteration', 'backward Euler, one iteration', 's5', 2, ''),
    ('HHT, 0.1', 'HHT, 0.1', 's6', 2, ''),
    ('KR-alpha, 0.8', 'KR-alpha, 0.8', 's7', 2, ''),
]


def text(value):
    return html.escape(str(value))


def number(x, digits=3):
    """Three digits, without an exponent where people do not expect one."""
    if x is None or x != x:
        return ''
    if x != 0 and (abs(x) < 1e-4 or abs(x) >= 1e7):
        return '%.*g' % (digits, x)
    if abs(x) >= 1000:
        return '{:,.0f}'.format(x).replace(',', '\u202f')
    places = max(0, digits - 1 - int(math.floor(math.log10(abs(x))))) if x else 0
    return '%.*f' % (places, x)


def read(path):
    try:
        with open(path, encoding='utf-8', errors='replace') as f:
            return f.read()
    except OSError:
        return ''


# ---------------------------------------------------------------------------------------------
# what the benches printed
# ---------------------------------------------------------------------------------------------

def parse_bench(out):
    machine = re.search(r'^machine: *(.*)$', out, re.M)
    flags = re.search(r'^flags: *(.*?) *, compiler *(.*)$', out, re.M)
    ceiling = re.search(r'memory ([\d.]+) GB/s.*?here ([\d.]+) GFLOP/s(?:.*?wide ([\d.]+) GFLOP/s)?', out)
    keys = ('tets dofs | mesh model first again | predict solve finish step mixed | nnz model_mb factor_mb '
            'body_mb').replace('|', '').split()
    rows = []
    for line in out.splitlines():
        values = line.replace('|', ' ').split()
        if len(values) == len(keys) and re.match(r'^ *\d', line):
            rows.append(dict(zip(keys, map(float, values))))
    return {
        'machine': machine.group(1).strip() if machine else '',
        'flags': flags.group(1) if flags else '',
        'compiler': flags.group(2) if flags else '',
        'memory': float(ceiling.group(1)) if ceiling else None,
        'flops': float(ceiling.group(2)) if ceiling else None,
        'wide': float(ceiling.group(3)) if ceiling and ceiling.group(3) else None,
        'rows': rows,
    }


def parse_solver(out):
    one = re.compile(r'^(\S.*?)\s+((?:[\d.e+]+\s+){7}[\d.e+]+)\s+(AMD|cuts)(?:\s+([\d.]+))?'
                     r'(?:\s*\|\s*([\d.]+)\s+([\d.]+)\s+([\d.]+)\s*\|\s*([\d.]+)\s+([\d.]+)\s+([\d.]+)\s+([\d.]+)\s+(.*))?$')
    two = re.compile(r'^(\S.*?)\s+([\d.]+)\s+([\d.]+)\s+([\d.]+)\s+([\d.]+)\s+([\d.]+)\s+([\d.]+)\s+(same bits|BITS DIFFER)$')
    rows, threads = [], []
    for line in out.splitlines():
        m = one.match(line.rstrip())
        if m:
            n = list(map(float, m.group(2).split()))
            rows.append({'name': m.group(1), 'factor': n[0], 'solve': n[2], 'solve32': n[3], 'analysis': n[5],
                         'flops': float(m.group(4)) if m.group(4) else None,
                         'ratio': [float(m.group(k)) for k in range(8, 12)] if m.group(8) else None})
        m = two.match(line.rstrip())
        if m:
            threads.append((m.group(1), float(m.group(4)), float(m.group(7)), m.group(8)))
    return rows, threads


def parse_eigen(out):
    rows = []
    for line in out.splitlines():
        m = re.match(r'^ *(\d+) +(\d+) \| +([\d.]+) +\d+ +(\d+) +(\S+)(?: \| +([\d.]+) +\d+ +(\d+) +(\S+))?', line)
        if m:
            rows.append({'tets': int(m.group(1)), 'modes': int(m.group(2)), 'ours': float(m.group(3)),
                         'lost': int(m.group(4)), 'error': float(m.group(5)),
                         'arpack': float(m.group(6)) if m.group(6) else None,
                         'arpack_lost': int(m.group(7)) if m.group(7) else None})
    return rows


def parse_csv(path):
    try:
        with open(path, encoding='utf-8', newline='') as f:
            return list(csv.DictReader(f))
    except OSError:
        return []


# ---------------------------------------------------------------------------------------------
# plots
# ---------------------------------------------------------------------------------------------

class Axes:
    """Logarithmic axes in a box of W x H; y upward."""
    W, H, LEFT, RIGHT, TOP, BOTTOM = 460, 330, 66, 12, 10, 44

    def __init__(self, xs, ys, x_label, y_label):
        self.range = []
        for values in (xs, ys):
            low, high = math.log10(min(values)), math.log10(max(values))
            margin = 0.04 * (high - low) + 0.03
            self.range.append((low - margin, high + margin))
        self.out = ['<svg viewBox="0 0 %d %d" role="img">' % (self.W, self.H)]
        self.draw_axis(0)
        self.draw_axis(1)
        middle_x = (self.LEFT + self.W - self.RIGHT) / 2
        middle_y = (self.TOP + self.H - self.BOTTOM) / 2
        self.out.append('<text x="%g" y="%g" text-anchor="middle">%s</text>' % (middle_x, self.H - 6, text(x_label)))
        self.out.append('<text transform="translate(13 %g) rotate(-90)" text-anchor="middle">%s</text>'
                        % (middle_y, text(y_label)))

    def x(self, value):
        low, high = self.range[0]
        return self.LEFT + (math.log10(value) - low) / (high - low) * (self.W - self.LEFT - self.RIGHT)

    def y(self, value):
        low, high = self.range[1]
        return self.H - self.BOTTOM - (math.log10(value) - low) / (high - low) * (self.H - self.TOP - self.BOTTOM)

    def draw_axis(self, which):
        low, high = self.range[which]
        steps = (1,) if high - low > 2.2 else (1, 2, 5)
        for power in range(math.floor(low), math.ceil(high) + 1):
            for step in steps:
                value = step * 10.0 ** power
                if not low <= math.log10(value) <= high:
                    continue
                label = ('%g' % value) if 1e-4 <= value < 1e6 else '1e%d' % power
                if value >= 1e4:
                    label = '%gk' % (value / 1e3)
                if which == 0:
                    at = self.x(value)
                    self.out.append('<path class="grid" d="M%.1f %gV%g"/><text x="%.1f" y="%g" text-anchor="middle">%s</text>'
                                    % (at, self.TOP, self.H - self.BOTTOM, at, self.H - self.BOTTOM + 17, label))
                else:
                    at = self.y(value)
                    self.out.append('<path class="grid" d="M%g %.1fH%g"/><text x="%g" y="%.1f" text-anchor="end">%s</text>'
                                    % (self.LEFT, at, self.W - self.RIGHT, self.LEFT - 7, at + 4, label))

    def line(self, points, color, width, dash='', title=''):
        d = ' '.join('%s%.1f %.1f' % ('L' if i else 'M', self.x(x), self.y(y)) for i, (x, y) in enumerate(points))
        self.out.append('<path d="%s" fill="none" stroke="var(--%s)" stroke-width="%g" stroke-linejoin="round"%s><title>%s</title></path>'
                        % (d, color, width, ' stroke-dasharray="%s"' % dash if dash else '', text(title)))

    def dots(self, points, color, radius, titles):
        for (x, y), title in zip(points, titles):
            self.out.append('<circle cx="%.1f" cy="%.1f" r="%g" fill="var(--%s)"><title>%s</title></circle>'
                            % (self.x(x), self.y(y), radius, color, text(title)))

    def svg(self):
        return ''.join(self.out) + '</svg>'


def legend(entries):
    """Of (name, color) or (name, color, dashes)."""
    look = {True: 'repeating-linear-gradient(90deg,var(--%s) 0 5px,transparent 5px 8px)', False: 'var(--%s)'}
    return '<div class="legend">%s</div>' % ''.join(
        '<span><i style="background:%s"></i>%s</span>' % (look[bool(dash)] % color, text(name))
        for name, color, dash in ((*e, '')[:3] for e in entries))


def table(head, rows, css=''):
    return ('<div class="scroll card"><table class="%s"><tr>%s</tr>%s</table></div>'
            % (css, ''.join('<th>%s</th>' % h for h in head),
               ''.join('<tr>%s</tr>' % ''.join('<td>%s</td>' % c for c in row) for row in rows)))


def ratio_cell(value):
    if value is None:
        return ''
    return '<span class="%s">%.2f</span>' % ('good' if value <= 1 else 'bad', value)


def ratio_plot(rows, names):
    """Ratios on a logarithmic axis: a row of dots for each (label, values); left of the line at 1 is faster."""
    values = [v for _, series in rows for v in series if v]
    low, high = math.log10(min(values + [0.5])) - 0.05, math.log10(max(values + [2])) + 0.05
    width, left, step = 460, 92, 22
    height = 24 + step * len(rows)

    def x(v):
        return left + (math.log10(v) - low) / (high - low) * (width - left - 12)
    out = ['<svg viewBox="0 0 %d %d" role="img">' % (width, height)]
    for v in (0.1, 0.2, 0.5, 1, 2, 5, 10):
        if low <= math.log10(v) <= high:
            out.append('<path d="M%.1f 4V%d" stroke="var(--%s)"/><text x="%.1f" y="%d" text-anchor="middle">%g</text>'
                       % (x(v), height - 20, 'soft' if v == 1 else 'grid', x(v), height - 5, v))
    for k, (label, series) in enumerate(rows):
        y = 16 + step * k
        out.append('<text x="%d" y="%d" text-anchor="end">%s</text>' % (left - 10, y + 4, text(label)))
        for v, (name, color) in zip(series, names):
            if v:
                out.append('<circle cx="%.1f" cy="%d" r="5" fill="var(--%s)"><title>%s, %s: %.2f</title></circle>'
                           % (x(v), y, color, text(label), text(name), v))
    return legend(names) + '<div class="plots" style="margin-bottom:12px"><div class="card">%s</svg></div></div>' % ''.join(out)


# ---------------------------------------------------------------------------------------------
# sections
# ---------------------------------------------------------------------------------------------

def head(bench, quick):
    now = datetime.datetime.now(datetime.timezone.utc)
    cores = os.cpu_count() or 1
    load = os.getloadavg()[0] if hasattr(os, 'getloadavg') else None
    tiles = [(text(bench['machine'] or 'unknown processor'), '%d cores' % cores)]
    if bench['memory']:
        tiles.append((number(bench['memory']) + ' GB/s', 'memory, one core'))
    if bench['wide']:
        tiles.append((number(bench['wide']) + ' GFLOP/s', 'fused multiply-adds, 4 wide'))
    if bench['flops']:
        tiles.append((number(bench['flops']) + ' GFLOP/s', 'multiply-adds as compiled'))
    if load is not None:
        tiles.append((number(load, 2), 'load in the last minute'))
    return ('<h1>softfem.h: what it costs</h1><p>Measured %s UTC%s. One thread where nothing else is said. '
            'The ceilings below are of the same run; compare ratios, not times, where others use the machine.</p>'
            '<div class="tiles">%s</div><p style="margin-top:10px"><code>%s</code>%s</p>'
            % (now.strftime('%Y-%m-%d %H:%M'), ', by <code>QUICK=1</code>: fewer sizes, scenes and repetitions' if quick else '',
               ''.join('<div class="card tile"><b>%s</b><span>%s</span></div>' % t for t in tiles),
               text(bench['flags']), ', compiler %s' % text(bench['compiler']) if bench['compiler'] else ''))


def scene_plot(rows):
    points = {}
    for r in rows:
        error, time = float(r['error'] or 'nan'), float(r['ms_per_second'] or 'nan')
        if not r['failure'] and error > 0 and time > 0 and error <= 2:
            points.setdefault(r['method'], []).append((time, error, float(r['h'])))
    everything = [p for series in points.values() for p in series]
    if not everything:
        return ''
    a = Axes([p[0] for p in everything], [p[1] for p in everything], 'ms of processor per simulated second', 'error / motion')
    front, best = [], float('inf')
    for time, error, _ in sorted(everything):
        if error < best:
            best = error
            front.append((time, error))
    a.line(front, 'front', 9, title='Pareto front: nothing is as accurate in less time')
    drawn = {m for m, *_ in LINES}

    def titles(method):
        return ['%s, h = 1/%.0f s: error %s, %s ms' % (method, 1 / h, number(e), number(t)) for t, e, h in points[method]]
    for method, series in points.items():
        if method not in drawn:
            a.dots([p[:2] for p in series], 'dot', 2.2, titles(method))
    for method, name, color, width, dash in reversed(LINES):
        if method in points:
            series = [p[:2] for p in points[method]]
            a.line(series, color, width, dash, name)
            a.dots(series, color, 2 + 0.4 * width, titles(method))
    return a.svg()


def time_to(rows, error):
    """Time to an error, from the logarithmic line through a method's points; as bench/integrators.c has it."""
    best, last = None, None
    for r in rows:
        e, t = float(r['error'] or 'nan'), float(r['ms_per_second'] or 'nan')
        if r['failure']:
            e = float('nan')
        if e <= error:
            time = t
            if last and last[0] > error and last[1] < t:
                time = t * (last[1] / t) ** (math.log(error / e) / math.log(last[0] / e))
            best = time if best is None else min(best, time)
        last = (e, t) if e == e else None
    return best


def integrators(rows):
    if not rows:
        return missing('Run time against error', 'make bench-integrators')
    scenes = list(dict.fromkeys(r['scene'] for r in rows))
    methods = list(dict.fromkeys(r['method'] for r in rows))
    shown = [m for m, *_ in LINES if m in methods]
    cards = ''.join('<div class="card"><h3>%s</h3>%s</div>'
                    % (text(s), scene_plot([r for r in rows if r['scene'] == s])) for s in scenes)
    body = []
    for m in methods:
        cells = [text(m) if m not in shown else '<b>%s</b>' % text(m)]
        for level in (0.1, 0.03, 0.01, 0.003):
            ratios = []
            for s in scenes:
                own = time_to([r for r in rows if r['scene'] == s and r['method'] == m], level)
                base = time_to([r for r in rows if r['scene'] == s and r['method'] == 'default'], level)
                if own and base:
                    ratios.append(own / base)
            ratios.sort()
            cells.append('%s <span style="color:var(--soft)">(%d)</span>' % (number(ratios[len(ratios) // 2]), len(ratios))
                         if ratios else '')
        mine = [r for r in rows if r['method'] == m]
        failed = sum(1 for r in mine if r['failure'])
        cells.append('<span class="%s">%d of %d</span>' % ('bad' if failed else '', failed, len(mine)))
        body.append(cells)
    return ('<h2>Run time against error</h2><p>Each point is one step length of one method: lower is more accurate, further '
            'left is faster. The pale band is the Pareto front. The error is the distance from a solution converged in time, '
            'over the motion. Grey dots are other settings and methods: hold the pointer over one for its name.</p>'
            + legend([(n, c, d) for m, n, c, _, d in LINES if m in methods]) + '<div class="plots">' + cards + '</div>'
            + '<details><summary>Time to an error over that of the default, every method</summary>'
            + '<p>The median over the scenes in which both get there (how many); the last column counts runs that '
              'failed: an error, an explosion, or a step beyond the stable one.</p>'
            + table(['', '10 %', '3 %', '1 %', '0.3 %', 'failed'], body) + '</details>')


def sizes(bench):
    rows = bench['rows']
    if not rows:
        return missing('Cost by size', 'make bench-body')
    body = []
    for r in rows:
        share = 2e6 * r['factor_mb'] / r['solve'] / 1e3 / bench['memory'] if bench['memory'] else None
        body.append([number(r['tets']), number(r['dofs'])]
                    + [number(r[k]) for k in ('model', 'first', 'again', 'step', 'solve', 'mixed', 'factor_mb')]
                    + ['%.0f %%' % (100 * share) if share else ''])
    plot = ''
    if len(rows) > 1:
        tets = [r['tets'] for r in rows]
        a = Axes(tets, [r[k] for r in rows for k in ('step', 'solve', 'mixed')], 'tets', 'us a step')
        for key, color, name in (('solve', 's4', 'of it the solve'), ('mixed', 's1', 'a step with a float factor'),
                                 ('step', 's0', 'a step')):
            series = [(r['tets'], r[key]) for r in rows]
            a.line(series, color, 2.4, title=name)
            a.dots(series, color, 3, ['%s: %s tets, %s us' % (name, number(x), number(y)) for x, y in series])
        plot = ('<div class="plots"><div class="card">' + a.svg() + '</div></div>')
    return ('<h2>Cost by size</h2><p>Clamped blocks, linear, (p,q,r) with p = 1/4, h = 1/60 s. A solve reads the factor '
            'twice: the last column is that rate over the memory ceiling; beyond 100 % the factor fits the caches.</p>'
            + legend([('a step', 's0'), ('of it the solve', 's4'), ('a step with a float factor', 's1')]) + plot
            + '<div style="height:12px"></div>'
            + table(['tets', 'dofs', 'model ms', 'first factor ms', 'again ms', 'step us', 'of it solve us',
                     'mixed: step us', 'factor MB', 'of memory ceiling'], body))


def cholmod(out):
    rows, threads = parse_solver(out)
    if not rows:
        return missing('The sparse solver beside CHOLMOD', 'make bench-solver')
    there = [r for r in rows if r['ratio']]
    result = ['<h2>The sparse solver beside CHOLMOD</h2>']
    if there:
        result.append('<p>Time over that of CHOLMOD at its best (best ordering, supernodal or simplicial, OpenBLAS), in '
                      'turns in one process: below 1 is faster. Flops: operations of the factor over those with '
                      "METIS's ordering.</p>")
        result.append(ratio_plot([(r['name'], r['ratio'][:3]) for r in there],
                                 [('factor', 's0'), ('solve', 's4'), ('solve, float factor', 's1')]))
        body = [[text(r['name']), number(r['factor']), number(r['solve'])] + [ratio_cell(x) for x in (r['ratio'] or [None] * 4)]
                + [ratio_cell(r['flops'])] for r in rows]
        result.append(table(['tets', 'factor ms', 'solve us', 'factor', 'solve', 'solve, float factor', 'analysis', 'flops'], body))
    else:
        result.append('<p>CHOLMOD is not installed (Debian: <code>apt-get install libsuitesparse-dev libopenblas-dev '
                      'libmetis-dev</code>), so these are our own times alone.</p>')
        result.append(table(['tets', 'factor ms', 'solve us', 'solve us, float factor', 'analysis ms'],
                            [[text(r['name'])] + [number(r[k]) for k in ('factor', 'solve', 'solve32', 'analysis')] for r in rows]))
    if threads:
        result.append('<details><summary>Two threads</summary><p>Gain over one thread; the bits have to be the same.</p>'
                      + table(['tets', 'factor', 'solve', 'result'],
                              [[text(n), number(f), number(s), text(b)] for n, f, s, b in threads]) + '</details>')
    return ''.join(result)


def arpack(out):
    rows = parse_eigen(out)
    if not rows:
        return missing('Modes beside ARPACK', 'make bench-eigen')
    there = any(r['arpack'] for r in rows)
    result = ['<h2>Modes beside ARPACK</h2><p>The lowest modes of clamped blocks by block Lanczos, with the inertia count that '
              'shows that none is missing']
    result.append(', against ARPACK on CHOLMOD\'s factor, which counts nothing: below 1 is faster.</p>' if there else
                  '. ARPACK is not installed (Debian: <code>apt-get install libarpack2-dev libsuitesparse-dev</code>), so '
                  'these are our own times alone.</p>')
    if there:
        for_size = {}
        for r in rows:
            for_size.setdefault(r['tets'], {})[r['modes']] = r['ours'] / r['arpack'] if r['arpack'] else None
        counts = sorted({r['modes'] for r in rows})
        result.append(ratio_plot([('%s tets' % number(t), [v.get(c) for c in counts]) for t, v in for_size.items()],
                                 [('%d modes' % c, k) for c, k in zip(counts, ('s0', 's4', 's1'))]))
    body = []
    for r in rows:
        cells = [number(r['tets']), str(r['modes']), number(r['ours']), '%d' % r['lost'], '%.0e' % r['error']]
        if there:
            cells += [number(r['arpack']), '%s' % r['arpack_lost'],
                      ratio_cell(r['ours'] / r['arpack']) if r['arpack'] else '']
        body.append(cells)
    result.append(table(['tets', 'modes', 'ms', 'lost', 'backward error'] + (['ARPACK ms', 'lost', 'ratio'] if there else []), body))
    return ''.join(result)


def needs(rows, out):
    if not rows:
        return missing('Only what a scene needs', 'make bench-needs')
    first = out.splitlines()[0] if out else ''
    body = []
    for r in rows:
        us, kb = (float(r['us_without']), float(r['us_with'])), (float(r['kb_without']), float(r['kb_with']))
        most = max(us)
        bars = ''.join('<i style="width:%.1f%%;background:var(--%s)"></i>' % (100 * u / most, c)
                       for u, c in zip(us, ('bar', 'bar2')))
        body.append(['<b>%s</b><small>%s / %s</small>' % (text(r['what']), text(r['without']), text(r['with'])), '<div class="pair">%s</div>' % bars,
                     number(us[0]), number(us[1]), '\u00d7\u2009' + number(us[1] / us[0]),
                     number(kb[0]), number(kb[1])])
    return ('<h2>Only what a scene needs</h2><p>The same body without and with one thing, stepped in turns in one process: '
            'what is not asked for should cost nothing. %s.</p>' % text(first.split(';')[0].capitalize())
            + legend([('without', 'bar'), ('with', 'bar2')])
            + table(['', '', 'without, us', 'with, us', 'with over without', 'without, kB', 'with, kB'], body, 'pairs'))


def missing(title, command):
    return '<h2>%s</h2><p>Not measured in this run: <code>%s</code>.</p>' % (text(title), text(command))


def page(directory, integrators_csv, quick):
    out = {name: read(os.path.join(directory, name + '.txt')) for name in ('bench', 'solver', 'eigen', 'needs', 'integrators')}
    bench = parse_bench(out['bench'])
    raw = ''.join('<details><summary>%s.txt</summary><pre>%s</pre></details>' % (name, text(content))
                  for name, content in out.items() if content)
    body = [head(bench, quick), integrators(parse_csv(integrators_csv)), cholmod(out['solver']), arpack(out['eigen']),
            needs(parse_csv(os.path.join(directory, 'needs.csv')), out['needs']), sizes(bench),
            '<h2>As printed</h2><p>Written by <code>make bench%s</code>; other benches: <code>make help</code>. Figures '
            'of a fixed date and their meaning: <code>bench/README.md</code>.</p>' % (' QUICK=1' if quick else ''), raw]
    return ('<!doctype html><html lang="en"><head><meta charset="utf-8"><meta name="viewport" '
            'content="width=device-width, initial-scale=1"><title>softfem.h: what it costs</title><style>%s</style></head>'
            '<body><main>%s</main></body></html>\n' % (CSS, ''.join(body)))


def main():
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    path = os.path.join(sys.argv[1], 'report.html')
    with open(path, 'w', encoding='utf-8') as f:
        f.write(page(sys.argv[1], sys.argv[2], 'quick' in sys.argv[3:]))
    print('open this: ' + path)


if __name__ == '__main__':
    main()
