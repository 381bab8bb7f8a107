#!/usr/bin/env python3
"""Meshes made by other programs are read, and those of softfem.h are read by them: gmsh, TetGen, meshio, VTK, CalculiX.

    python3 tests/interop.py PROGRAMS SCRATCH [--need-all] [NAME...]

PROGRAMS is where interop_dump, simulate and tetrahedralize are, SCRATCH a directory for files. Runs the tests of those
names, by default all. A test whose program is missing is skipped, and with --need-all fails. Debian's packages: gmsh
tetgen python3-meshio python3-vtk9 calculix-ccx.
"""
import contextlib
import io
import json
import os
import re
import shutil
import subprocess
import sys
import time
import xml.etree.ElementTree as ElementTree

PROGRAMS, SCRATCH = sys.argv[1:3]

TWO = """SetFactory("OpenCASCADE");
Box(1) = {0,0,0, 1,0.3,0.3};
Box(2) = {1,0,0, 0.7,0.3,0.3};
Coherence;
Physical Volume("soft part", 11) = {1};
Physical Volume("hard", 12) = {2};
Physical Volume("all", 13) = {1,2};
Physical Surface("left") = Surface In BoundingBox {-0.01,-1,-1, 0.01,1,1};
Physical Surface("right") = Surface In BoundingBox {1.69,-1,-1, 1.71,1,1};
Physical Curve("edge") = Curve In BoundingBox {-0.01,-0.01,-1, 0.01,0.01,1};
Physical Point("corner") = Point In BoundingBox {-0.01,-0.01,-0.01, 0.01,0.01,0.01};
Mesh.MeshSizeMax = 0.15;
"""


class Missing(Exception):
    pass


def require(condition, text):
    if not condition:
        raise AssertionError(text)


def path(name):
    return os.path.join(SCRATCH, name)


def run(*command, code=0):
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, cwd=SCRATCH, timeout=120)
    text = done.stdout.decode(errors='replace')
    require(code is None or done.returncode == code, '%s: exit %d\n%s' % (' '.join(command), done.returncode, text[-2000:]))
    return text


def ours(name, *arguments, code=0):
    return run(os.path.join(PROGRAMS, name), *arguments, code=code)


def program(name):
    if not shutil.which(name):
        raise Missing(name)
    return name


def module(name):
    try:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            return __import__(name, fromlist=['x'])
    except ImportError:
        raise Missing('the Python module ' + name)


def dump(name, *options, code=0):
    return json.loads(ours('interop_dump', path(name), *options, code=code))


def equal(d, x, tets, what, tolerance=0.0):
    """Positions and tets of a dump; a tet may have its last two nodes swapped."""
    require(len(d['x']) == len(x), '%s: %d nodes, not %d' % (what, len(d['x']), len(x)))
    worst = max(abs(a - float(b)) for p, q in zip(d['x'], x) for a, b in zip(p, q))
    require(worst <= tolerance, '%s: a node is off by %g' % (what, worst))
    require(len(d['tets']) == len(tets), '%s: %d tets, not %d' % (what, len(d['tets']), len(tets)))
    for t, (a, b) in enumerate(zip(d['tets'], tets)):
        b = [int(k) for k in b]
        require(a == b or a == b[:2] + [b[3], b[2]], '%s: tet %d has nodes %s, not %s' % (what, t, a, b))


def members(d, name):
    require(name in d['sets'], "there is no set '%s', only %s" % (name, ', '.join(d['sets'])))
    return d['sets'][name]


def quiet(call, *arguments, **named):
    """meshio speaks on stdout."""
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        return call(*arguments, **named)


# ---- the options of simulate, of files made here ----

SEAM = """*NODE
1, 0, 0, 0
2, 1, 0, 0
3, 0, 1, 0
4, 0, 0, 1
5, 1, 0, 0
6, 0, 1, 0
7, 0, 0, 1
8, 1, 1, 1
*ELEMENT, TYPE=C3D4, ELSET=low
1, 1, 2, 3, 4
*ELEMENT, TYPE=C3D4, ELSET=high
2, 5, 6, 7, 8
*NSET, NSET=held
1, 2, 3, 4
*NSET, NSET=tip
8
*MATERIAL, NAME=foam
*ELASTIC
1e4, 0.1
*DENSITY
30
*SOLID SECTION, ELSET=low, MATERIAL=foam
*SOLID SECTION, ELSET=high, MATERIAL=foam
"""


def simulate_names():
    with open(path('seam.inp'), 'w') as f:
        f.write(SEAM)
    name = path('seam.inp')
    text = ours('simulate', name, '--info')
    for words in ('mesh: 8 nodes, 2 tets', '2 pieces', 'split the body along 1 faces: 2 components instead of 1; --weld 0',
                  "region 'low': number 0, 1 tets, material 'foam', E 10000 Pa, nu 0.1, 30 kg/m^3", "set 'held': 4 nodes",
                  "set 'tip': 1 nodes", 'Euler characteristic 4'):
        require(words in text, "--info does not say '%s':\n%s" % (words, text))
    text = ours('simulate', name, '--info', '--weld', '0')
    require('3 nodes welded' in text and '1 piece\n' in text and 'warning' not in text, text)
    for option, value in (('--fix', 'set:hold'), ('--load', 'set:hold:1,2,3')):
        text = ours('simulate', name, '--weld', '0', option, value, code=2)
        require("%s: there is no set 'hold' in this mesh. Regions: 'low' 'high'. Sets: 'low' 'high' 'held' 'tip'" % option in text,
                text)
    text = ours('simulate', name, '--region', 'middle:1,0.3,1', code=2)
    require("there is no region 'middle' in this mesh. Regions: 'low' 'high'" in text, text)

    def tip(*options):
        text = ours('simulate', name, '--weld', '0', '--static', '--material', 'linear', '--gravity', '0,0,0', '--fix', 'set:held',
                    '--load', 'set:tip:0,0,1', '--probe', '4', '--out', path('seam'), *options)
        return float(re.search('probe 4 .* (.*)\n', text).group(1))

    require(abs(tip('--region', 'high:5e3,0.1,30') / tip() - 2) < 1e-12, '--region: half the modulus is not twice the way')
    require(abs(tip('--young', '2e4', '--poisson', '0.1') / tip() - 0.5) < 1e-12, "--young is not stronger than the file's")
    with open(path('box.obj'), 'w') as f:
        f.write(''.join('v %d %d %d\n' % (2 * (i & 1), i >> 1 & 1, i >> 2) for i in range(8)) +
                'f 1 3 4 2\nf 5 6 8 7\nf 1 2 6 5\nf 3 7 8 4\nf 1 5 7 3\nf 2 4 8 6\n')
    text = ours('simulate', path('box.obj'), code=2)
    require('this file has 12 triangles and no tets; --tets 5000 makes some' in text, text)
    text = ours('simulate', path('box.obj'), '--tets', '800', '--cage', '--static', '--fix', 'x<0.1', '--out', path('box'))
    require(680 < int(re.search('\ntets (.*)', text).group(1)) < 920, text)


def wrong_options():
    """What would be ignored or misread is refused, with a sentence that names the option."""
    bar, box = path('bar.veg'), path('box.obj')
    ours('tetrahedralize', '--quick', '--out', path('wrong'))
    ours('tetrahedralize', path('wrong/mesh.msh'), bar, '--out', path('wrong'))
    with open(box, 'w') as f:
        f.write(''.join('v %d %d %d\n' % (2 * (i & 1), i >> 1 & 1, i >> 2) for i in range(8)) +
                'f 1 3 4 2\nf 5 6 8 7\nf 1 2 6 5\nf 3 7 8 4\nf 1 5 7 3\nf 2 4 8 6\n')
    for words, options in (
            ('--threads: -1 is below 1', ('--threads', '-1')),
            ('--weld and --linear are of a file with tets, and here is none', ('--weld', '-1')),
            ('the distance of welding is -1, not 0 or above', (bar, '--weld', '-1')),
            ('take a smaller distance', (bar, '--weld', '100')),
            ('--weld and --linear are of a file with tets, and here is a surface', (box, '--tets', '100', '--linear')),
            ('--tets and --cage fill the surface in a file, and here is none', ('--cage',)),
            ('--cells: 1.5 is not a whole number', ('--cells', '1.5,1,1')),
            ('--cells: nan is not a whole number', ('--cells', 'nan,1,1')),
            ('--steps must be at most 10000000', ('--steps', '2147483647')),
            ('--steps: 0 is below 1', ('--steps', '0')),
            ('--probe: -7 is below -1', ('--probe', '-7')),
            ('--vtu: -3 is below 0', ('--vtu', '-3')),
            ('the seed -1 is not a whole number', ('--velocity', 'random:1,-1')),
            ('the seed 1e+300 is not a whole number', ('--velocity', 'random:1,1e300')),
            ('--grab: no node of the surface is within 1 m of 1e+300,0,0', ('--grab', '1e300,0,0,1')),
            ('modal bodies do not break', ('--integrator', 'modal', '--fracture', '1')),
            ('the name of a directory is empty', ('--out', ''))):
        text = ours('simulate', '--out', path('wrong'), '--quick', *options, code=2)
        require(words in text, "simulate %s does not say '%s':\n%s" % (' '.join(options), words, text))
    with open(path('hex.mesh'), 'w') as f:
        f.write('MeshVersionFormatted 1\nDimension 3\nVertices 8\n0 0 0 0 1 0 0 0 1 1 0 0 0 1 0 0\n0 0 1 0 1 0 1 0 1 1 1 0 0 1 1 0\n'
                'Quadrilaterals 1\n1 2 3 4 0\nHexahedra 1\n1 2 3 4 5 6 7 8 0\nEnd\n')
    with open(path('ten.inp'), 'w') as f:
        f.write('*NODE\n1,0,0,0\n2,1,0,0\n3,0,1,0\n4,0,0,1\n5,.5,0,0\n6,.5,.5,0\n7,0,.5,0\n8,0,0,.5\n9,.5,0,.5\n10,0,.5,.5\n'
                '*ELEMENT,TYPE=S3\n1,1,2,3\n*ELEMENT,TYPE=C3D10\n2,1,2,3,4,5,6,7,8,9,10\n')
    for words, name in (('there are 1 volume cells, but none is a tet', 'hex.mesh'), ('here --linear', 'ten.inp')):
        for which, options in (('simulate', ()), ('tetrahedralize', (path('wrong/x.msh'),))):
            text = ours(which, path(name), *options, '--out', path('wrong'), code=2)
            require(words in text, "%s %s does not say '%s':\n%s" % (which, name, words, text))
    for words, out in (('the name has to end in .msh, .vtu or .veg', 'x.foo'), ('No such file or directory', 'none/x.msh')):
        text = ours('tetrahedralize', box, path(out), '--tets', '100', '--out', path('wrong'), code=2)
        require(words in text and 'angles' not in text, "told after the work, or not at all: '%s'\n%s" % (words, text))
    text = ours('tetrahedralize', '--threads', '-1', '--out', path('wrong'), code=2)
    require('--threads: -1 is below 1' in text, text)


# ---- gmsh ----

def gmsh(source, out, *options):
    run(program('gmsh'), path(source), '-o', path(out), '-v', '2', '-save' if source.endswith('.msh') else '-3', *options)
    return out


def two_parts():
    """Two boxes with named parts; what gmsh wrote, and what is in it."""
    with open(path('two.geo'), 'w') as f:
        f.write(TWO)
    return dump(gmsh('two.geo', 'two41.msh', '-format', 'msh41'))


def check_two(d, first, what, tolerance=0.0):
    equal(d, first['x'], first['tets'], what, tolerance)
    require(d['region'] == first['region'], what + ': other regions')
    require(d['sets'].items() >= first['sets'].items(), '%s: other sets: %s' % (what, ', '.join(d['sets'])))


def gmsh_groups():
    d = two_parts()
    x = d['x']
    for name, axis, at in (('left', 0, 0.0), ('right', 0, 1.7)):
        want = [i for i, p in enumerate(x) if abs(p[axis] - at) < 1e-9]
        require(members(d, 'nodes ' + name) == want, name + ': other nodes')
    require(members(d, 'nodes corner') == [i for i, p in enumerate(x) if max(map(abs, p)) < 1e-9], 'corner: other nodes')
    require(members(d, 'nodes edge') == [i for i, p in enumerate(x) if max(map(abs, p[:2])) < 1e-9], 'edge: other nodes')
    soft = [t for t, v in enumerate(d['tets']) if sum(x[k][0] for k in v) / 4 < 1]
    require(members(d, 'tets soft part') == soft, 'soft part: other tets')
    require(members(d, 'tets all') == list(range(len(d['tets']))), 'all: other tets')
    require([(r['name'], r['number'], r['tets']) for r in d['regions']] ==
            [('soft part', 11, len(soft)), ('hard', 12, len(d['tets']) - len(soft))], 'other regions: %s' % d['regions'])


def gmsh_formats():
    first = two_parts()
    check_two(dump(gmsh('two41.msh', 'two41b.msh', '-format', 'msh41', '-bin')), first, '4.1 binary')
    check_two(dump(gmsh('two41.msh', 'two22.msh', '-format', 'msh22')), first, '2.2')
    check_two(dump(gmsh('two41.msh', 'two22b.msh', '-format', 'msh22', '-bin')), first, '2.2 binary')
    for out, options in (('two.vtk', ()), ('twob.vtk', ('-bin',)), ('two.mesh', ()), ('two.inp', ())):
        d = dump(gmsh('two41.msh', out, *options))
        equal(d, first['x'], first['tets'], out, 1e-13)  # as many digits as it writes
        require(len(set(zip(d['region'], first['region']))) == 2, out + ': other regions')
    require(members(d, 'nodes left') == members(first, 'nodes left'), 'two.inp: other nodes of the ELSET left')
    require(members(d, 'tets soft_part') == members(first, 'tets soft part'), 'two.inp: other tets of soft_part')


def gmsh_partitions():
    first = two_parts()
    for out, options in (('part41.msh', ()), ('part41b.msh', ('-bin',))):
        d = dump(gmsh('two41.msh', out, '-format', 'msh41', '-part', '3', *options))
        # the same tets and nodes, in the order of the partitions
        require(sorted(d['x']) == sorted(first['x']), out + ': other nodes')
        def shapes(m):
            return sorted((sorted(m['x'][k] for k in v), r) for v, r in zip(m['tets'], m['region']))
        require(shapes(d) == shapes(first), out + ': other tets or regions')
        for name, of in first['sets'].items():
            require(len(members(d, name)) == len(of), '%s: %s has %d members' % (out, name, len(members(d, name))))


def gmsh_second_order():
    two_parts()
    for out, options in (('quad41.msh', ('-format', 'msh41')), ('quad41b.msh', ('-format', 'msh41', '-bin')),
                         ('quad22.msh', ('-format', 'msh22')), ('quad.vtk', ()), ('quad.inp', ())):
        gmsh('two.geo', out, '-order', '2', *options)
        d = dump(out, '--linear')
        error = dump(out, code=1)['error']
        count = len(d['tets']) * (2 if out == 'quad22.msh' else 1)  # 2.2 has each in both of its groups
        require('%d tets of 10 nodes' % count in error and "'linear'" in error, '%s: %s' % (out, error))
        require(d['info']['linear'] == len(d['tets']) > 400, out + ': other tets')
        # first-order mesh of the same program: 179 nodes or so, and no middle of an edge
        require(len(d['x']) < 0.25 * (len(d['x']) + d['info']['removed']), out + ': nodes of edges are left')
        used = {k for v in d['tets'] for k in v}
        require(used == set(range(len(d['x']))), out + ': nodes that no tet uses')


def torus():
    """2000 tets that tetrahedralize makes of the triangles of a torus, in torus/mesh.msh; made once."""
    if not os.path.exists(path('torus/done')):
        ours('tetrahedralize', '--tets', '2000', '--out', path('torus'))
        open(path('torus/done'), 'w').close()
    return dump('torus/mesh.msh')


def gmsh_reads_ours():
    d = torus()
    run(program('gmsh'), path('torus/mesh.msh'), '-save', '-o', path('torus.msh'), '-format', 'msh41', '-v', '2')
    equal(dump('torus.msh'), d['x'], d['tets'], 'ours through gmsh', 1e-15)  # it writes 16 digits
    with open(path('regions.mesh'), 'w') as f:  # of any number
        f.write('MeshVersionFormatted 2\nDimension 3\nVertices 5\n0 0 0 0 1 0 0 0 0 1 0 0 0 0 1 0 1 1 1 0\n'
                'Tetrahedra 4\n1 2 3 4 0\n2 3 4 5 5\n1 2 3 4 -7\n1 2 3 4 0\n')
    ours('tetrahedralize', path('regions.mesh'), path('regions.msh'), '--out', path('regions'))
    text = run(program('gmsh'), path('regions.msh'), '-save', '-save_all', '-o', path('regions2.msh'), '-format', 'msh41', '-v', '2')
    require('Error' not in text, text)
    d = dump('regions2.msh')
    require(sorted(d['region']) == [-7, 0, 0, 5], 'regions through gmsh: %s' % d['region'])


def gmsh_surface():
    two_parts()
    with open(path('ball.geo'), 'w') as f:
        f.write('SetFactory("OpenCASCADE");\nSphere(1) = {0,0,0, 1};\nMesh.MeshSizeMax = 0.3;\n')
    for out in ('ball.msh', 'ball.vtk', 'ball.mesh', 'ball.stl', 'ball.inp'):
        run(program('gmsh'), path('ball.geo'), '-2', '-o', path(out), '-v', '2')
        s = dump(out, '--surface')
        text = ours('simulate', path(out), '--info', code=2)
        require('this file has %d triangles and no tets; --tets 5000 makes some' % len(s['triangles']) in text, text)
        text = ours('simulate', path(out), '--tets', '1000', '--info')
        volume = float(re.search('volume ([0-9.e+-]+)', text).group(1))
        require(3.9 < volume < 4.2, '%s: volume %g' % (out, volume))


# ---- TetGen ----

def tetgen():
    with open(path('cube.off'), 'w') as f:
        f.write('OFF\n8 6 0\n' + ''.join('%d %d %d\n' % (i & 1, i >> 1 & 1, i >> 2) for i in range(8)) +
                '4 0 2 3 1\n4 4 5 7 6\n4 0 1 5 4\n4 2 6 7 3\n4 0 4 6 2\n4 1 3 7 5\n')
    run(program('tetgen'), '-pq1.2a0.01gAQz', path('cube.off'))  # no .vtk: there it counts from 1, which VTK does not
    d = dump('cube.1.node')
    with open(path('cube.1.node')) as f:
        rows = [line.split() for line in f if line[0] != '#'][1:]
    with open(path('cube.1.ele')) as f:
        tets = [line.split() for line in f if line[0] != '#'][1:]
    base = int(rows[0][0])
    equal(d, [[float(v) for v in r[1:4]] for r in rows], [[int(v) - base for v in t[1:5]] for t in tets], '.node and .ele')
    m = dump('cube.1.mesh')
    equal(m, d['x'], d['tets'], '.mesh', 1e-12)
    require(abs(volume_of(d) - 1) < 1e-12, 'the volume is not 1')
    run('tetgen', '-pq1.2a0.01AQ', path('cube.off'))
    equal(dump('cube.1.ele'), d['x'], d['tets'], 'counted from 1')
    run('tetgen', '-pq1.2a0.01o2Q', path('cube.off'))
    q = dump('cube.1.node', '--linear')
    require('elements of 10 nodes' in dump('cube.1.node', code=1)['error'], 'no word about 10 nodes')
    require(abs(volume_of(q) - 1) < 1e-12 and q['info']['removed'] > 0, 'second order: other tets')


def volume_of(d):
    total = 0
    for v in d['tets']:
        a, b, c, e = (d['x'][k] for k in v)
        u, w, z = ([p[k] - a[k] for k in range(3)] for p in (b, c, e))
        total += (u[0] * (w[1] * z[2] - w[2] * z[1]) + u[1] * (w[2] * z[0] - w[0] * z[2]) + u[2] * (w[0] * z[1] - w[1] * z[0])) / 6
    return total


# ---- meshio ----

def sample():
    """A grid of tets as numpy arrays: nodes, tets, a number for each tet."""
    numpy = module('numpy')
    n = 4
    x = numpy.array([[0.1 * i, 0.2 * j + 0.01 * i, 0.3 * k] for i in range(n) for j in range(n) for k in range(n)])
    tets = []
    for i in range(n - 1):
        for j in range(n - 1):
            for k in range(n - 1):
                c = [((i + a) * n + j + b) * n + k + e for a in (0, 1) for b in (0, 1) for e in (0, 1)]
                tets += [[c[0], c[4], c[6], c[7]], [c[0], c[6], c[2], c[7]], [c[0], c[2], c[3], c[7]],
                         [c[0], c[3], c[1], c[7]], [c[0], c[1], c[5], c[7]], [c[0], c[5], c[4], c[7]]]
    return x, numpy.array(tets), numpy.array([1 + t % 3 for t in range(len(tets))])


def meshio_writes():
    meshio = module('meshio')
    numpy = module('numpy')
    x, tets, region = sample()
    triangles = numpy.array([[0, 1, 5], [0, 5, 4]])
    mesh = meshio.Mesh(x, [('triangle', triangles), ('tetra', tets)],
                       cell_data={'medit:ref': [numpy.array([7, 7]), region]})
    tagged = meshio.Mesh(x, [('triangle', triangles), ('tetra', tets)],
                         cell_data={'gmsh:physical': [numpy.array([7, 7]), region],
                                    'gmsh:geometrical': [numpy.array([1, 1]), region]})
    for name, what, options in (('m.vtu', mesh, {'binary': True, 'compression': None}), ('ma.vtu', mesh, {'binary': False}),
                                ('m51.vtk', mesh, {'file_format': 'vtk51'}), ('m42.vtk', mesh, {'file_format': 'vtk42'}),
                                ('ma51.vtk', mesh, {'file_format': 'vtk51', 'binary': False}),
                                ('ma42.vtk', mesh, {'file_format': 'vtk42', 'binary': False}),
                                ('m.mesh', mesh, {}), ('m.meshb', mesh, {}),
                                ('m22.msh', tagged, {'file_format': 'gmsh22'}),
                                ('m22a.msh', tagged, {'file_format': 'gmsh22', 'binary': False})):
        quiet(meshio.write, path(name), what, **options)
        d = dump(name)
        equal(d, x, tets, name, 1e-12)
        require(d['region'] == list(region), name + ': other regions')
        require(members(d, 'nodes surface 7') == [0, 1, 4, 5], name + ': other nodes of surface 7')
    quiet(meshio.write, path('mz.vtu'), mesh, compression='zlib')
    error = dump('mz.vtu', code=1)['error']
    require('compressed' in error and 'raw' in error, error)


def meshio_sets():
    meshio = module('meshio')
    numpy = module('numpy')
    x, tets, region = sample()
    mesh = meshio.Mesh(x, [('tetra', tets)], point_sets={'bottom': numpy.arange(16)},
                       cell_sets={'first': [numpy.arange(5, 9)]})
    quiet(meshio.write, path('s.inp'), mesh)
    d = dump('s.inp')
    equal(d, x, tets, 's.inp', 1e-12)
    require(members(d, 'nodes bottom') == list(range(16)), 'other nodes')
    require(members(d, 'tets first') == list(range(5, 9)), 'other tets')
    quiet(meshio.write, path('t.node'), meshio.Mesh(x, [('tetra', tets)], cell_data={'tetgen:ref': [region]}),
          file_format='tetgen')
    d = dump('t.node')
    equal(d, x, tets, 't.node', 1e-12)
    require(d['region'] == list(region), 't.node: other regions')


def meshio_reads_ours():
    meshio = module('meshio')
    numpy = module('numpy')
    d = torus()
    ours('tetrahedralize', path('torus/mesh.msh'), path('torus/copy.vtu'), '--out', path('torus'))
    ours('tetrahedralize', path('torus/mesh.msh'), path('torus/copy.veg'), '--out', path('torus'))
    for name in ('torus/mesh.msh', 'torus/copy.vtu'):
        m = quiet(meshio.read, path(name))
        require(numpy.array_equal(m.points, numpy.array(d['x'])), name + ': other nodes')
        require(numpy.array_equal(m.cells_dict['tetra'], numpy.array(d['tets'])), name + ': other tets')
    for name in ('torus/copy.vtu', 'torus/copy.veg'):
        equal(dump(name), d['x'], d['tets'], name)


# ---- VTK ----

def grid_of(vtk, x, tets, region):
    numpy_support = module('vtk.util.numpy_support')
    numpy = module('numpy')
    points = vtk.vtkPoints()
    points.SetData(numpy_support.numpy_to_vtk(numpy.ascontiguousarray(x), deep=1))
    cells = vtk.vtkCellArray()
    for v in tets:
        cells.InsertNextCell(4, [int(k) for k in v])
    grid = vtk.vtkUnstructuredGrid()
    grid.SetPoints(points)
    grid.SetCells(10, cells)
    more = vtk.vtkDoubleArray()  # what is not needed stands before
    more.SetName('displacement')
    more.SetNumberOfComponents(3)
    more.SetNumberOfTuples(len(x))
    more.Fill(1.5)
    grid.GetPointData().AddArray(more)
    array = numpy_support.numpy_to_vtk(region.astype(numpy.int32), deep=1)
    array.SetName('region')
    grid.GetCellData().AddArray(array)
    return grid


def vtk_writes():
    vtk = module('vtk')
    x, tets, region = sample()
    grid = grid_of(vtk, x, tets, region)
    cases = []
    for mode in ('ascii', 'binary', 'raw', 'base64'):
        for order in (0, 1):
            for header in (32, 64):
                w = vtk.vtkXMLUnstructuredGridWriter()
                w.SetCompressorTypeToNone()
                w.SetHeaderType(header)
                w.SetByteOrder(order)
                if mode == 'ascii':
                    w.SetDataModeToAscii()
                elif mode == 'binary':
                    w.SetDataModeToBinary()
                else:
                    w.SetDataModeToAppended()
                    w.SetEncodeAppendedData(mode == 'base64')
                cases.append(('v_%s_%d_%d.vtu' % (mode, order, header), w))
    for version in (42, 51):
        for binary in (0, 1):
            w = vtk.vtkUnstructuredGridWriter()
            w.SetFileVersion(version)
            w.SetFileType(1 + binary)
            cases.append(('v_%d_%d.vtk' % (version, binary), w))
    for name, w in cases:
        w.SetFileName(path(name))
        w.SetInputData(grid)
        require(w.Write() == 1, name + ': VTK does not write it')
        d = dump(name)
        equal(d, x, tets, name, 1e-6 if 'ascii' in name or name.endswith('_0.vtk') else 0.0)  # 6 digits of text
        require(d['region'] == list(region), name + ': other regions')
    w = vtk.vtkXMLUnstructuredGridWriter()
    w.SetFileName(path('v_zlib.vtu'))
    w.SetInputData(grid)
    w.Write()
    error = dump('v_zlib.vtu', code=1)['error']
    require('SetCompressorTypeToNone' in error, error)


def vtk_reads_ours():
    vtk = module('vtk')
    numpy_support = module('vtk.util.numpy_support')
    numpy = module('numpy')
    ours('simulate', '--cells', '4,2,2', '--steps', '4', '--vtu', '2', '--csv', path('final.csv'), '--out', path('steps'))
    files = ElementTree.parse(path('steps/steps.pvd')).getroot().findall('.//DataSet')
    require([float(f.get('timestep')) for f in files] == [0, 2 / 120, 4 / 120], 'other times in the .pvd')
    for f in files:
        r = vtk.vtkXMLUnstructuredGridReader()
        r.SetFileName(path('steps/' + f.get('file')))
        r.Update()
        g = r.GetOutput()
        require(g.GetNumberOfPoints() == 45 and g.GetNumberOfCells() == 80, f.get('file') + ': another mesh')
        x = numpy_support.vtk_to_numpy(g.GetPoints().GetData())
        u = numpy_support.vtk_to_numpy(g.GetPointData().GetArray('displacement'))
        d = dump('steps/' + f.get('file'))
        tets = numpy_support.vtk_to_numpy(g.GetCells().GetConnectivityArray()).reshape(-1, 4)
        equal(d, x, tets, f.get('file'))
        require(g.GetCellData().GetArray('von_mises').GetNumberOfTuples() == 80, 'no stress')
    last = numpy.loadtxt(path('final.csv'), delimiter=',', skiprows=1)[:, 1:]
    require(numpy.array_equal(u, last), 'the last displacement is another one')


# ---- CalculiX ----

def write_inp(name, d, fixed):
    with open(path(name), 'w') as f:
        f.write('*NODE, NSET=NALL\n')
        for i, p in enumerate(d['x']):
            f.write('%d, %.17g, %.17g, %.17g\n' % (i + 1, *p))
        f.write('*ELEMENT, TYPE=C3D4, ELSET=EALL\n')
        for t, v in enumerate(d['tets']):
            f.write('%d, %d, %d, %d, %d\n' % (t + 1, *(k + 1 for k in v)))
        f.write('*NSET, NSET=HELD\n' + ''.join('%d,\n' % (i + 1) for i in fixed))
        f.write('*MATERIAL, NAME=RUBBER\n*ELASTIC\n2e6, 0.3\n*DENSITY\n1200\n*SOLID SECTION, ELSET=EALL, MATERIAL=RUBBER\n'
                '*BOUNDARY\nHELD, 1, 3\n*STEP\n*STATIC\n*DLOAD\nEALL, GRAV, 9.81, 0, 0, -1\n*NODE PRINT, NSET=NALL\nU\n'
                '*END STEP\n')


def calculix():
    ccx = program('ccx')
    d = torus()
    held = [i for i, p in enumerate(d['x']) if p[0] < -0.9]
    require(len(held) > 20, 'few nodes are held')
    write_inp('rubber.inp', d, held)
    back = dump('rubber.inp')
    equal(back, d['x'], d['tets'], 'the .inp')
    require(members(back, 'nodes HELD') == held, 'the .inp: other nodes are held')
    r = back['regions'][0]
    require((r['name'], r['material'], r['E'], r['nu'], r['rho']) == ('EALL', 'RUBBER', 2e6, 0.3, 1200), 'other constants: %s' % r)
    run(ccx, '-i', 'rubber')
    with open(path('rubber.dat')) as f:
        rows = [line.split() for line in f]
    theirs = {int(v[0]) - 1: [float(a) for a in v[1:4]] for v in rows if len(v) == 4 and v[0].isdigit()}
    require(len(theirs) == len(d['x']), 'CalculiX tells %d nodes of %d' % (len(theirs), len(d['x'])))
    ours('simulate', path('rubber.inp'), '--fix', 'set:HELD', '--static', '--material', 'linear', '--csv', path('rubber.csv'),
         '--out', path('ccx'))
    with open(path('rubber.csv')) as f:
        mine = [[float(a) for a in line.split(',')[1:]] for line in f.readlines()[1:]]
    size = max(abs(a) for u in mine for a in u)
    worst = max(abs(a - b) for i, u in enumerate(mine) for a, b in zip(u, theirs[i]))
    require(size > 1e-3, 'nothing moves: %g' % size)
    require(worst < 2e-6 * size, 'displacements differ by %g of the largest' % (worst / size))
    return 'displacements agree within %.1e of the largest, %.3g m' % (worst / size, size)


TESTS = [simulate_names, wrong_options, gmsh_groups, gmsh_formats, gmsh_partitions, gmsh_second_order, gmsh_reads_ours, gmsh_surface, tetgen, meshio_writes,
         meshio_sets, meshio_reads_ours, vtk_writes, vtk_reads_ours, calculix]


def main():
    names = [a for a in sys.argv[3:] if a != '--need-all']
    need_all = '--need-all' in sys.argv
    failed = skipped = 0
    shutil.rmtree(SCRATCH, ignore_errors=True)
    os.makedirs(SCRATCH)
    for test in TESTS:
        if names and test.__name__ not in names:
            continue
        begin = time.monotonic()
        try:
            note = test() or ''
            print('%-18s ok       %4.1f s  %s' % (test.__name__, time.monotonic() - begin, note), flush=True)
        except Missing as missing:
            skipped += 1
            print('%-18s skipped: %s is missing' % (test.__name__, missing), flush=True)
        except Exception as error:  # the others are still to be run
            failed += 1
            print('%-18s FAILED: %s: %s' % (test.__name__, type(error).__name__, error), flush=True)
    if skipped:
        print('%d skipped; Debian: apt-get install gmsh tetgen python3-meshio python3-vtk9 calculix-ccx' % skipped)
    sys.exit(1 if failed or (skipped and need_all) else 0)


if __name__ == '__main__':
    PROGRAMS, SCRATCH = os.path.abspath(PROGRAMS), os.path.abspath(SCRATCH)
    main()
