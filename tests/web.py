"""The page in headless Chromium, by WebDriver.

    python3 tests/web.py build/web/softfem.html build/web/native [TEST...]

The second is page.c compiled natively: it says what the hashes of the scenes have to be. Needs chromium and chromedriver
(Debian: chromium, chromium-driver). Pictures are left in build/web/pictures/.
"""
import base64
import json
import os
import shutil
import socket
import subprocess
import sys
import tempfile
import time
import urllib.error
import urllib.request

# 300 steps of each, natively and in the browser; with SIMD, and without
HASHED = ['grab', 'cut:blade=0.5', 'jelly', 'twist', 'drop', 'gripper:tets=800', 'shatter:tets=600', 'tear:tets=800', 'modes', 'mesh']
HASHED_PLAIN = ['cut:blade=0.5', 'shatter:tets=600']


class Browser:
    """One session of chromedriver: no more than what is needed here."""

    def __init__(self, log):
        with socket.socket() as probe:
            probe.bind(('127.0.0.1', 0))
            port = probe.getsockname()[1]
        self.profile = tempfile.mkdtemp(prefix='softfem-web-')
        self.driver = subprocess.Popen(['chromedriver', '--port=%d' % port], stdout=log, stderr=log)
        self.base = 'http://127.0.0.1:%d' % port
        self.session = None
        end = time.time() + 30
        while True:
            try:
                urllib.request.urlopen(self.base + '/status', timeout=5).read()
                break
            except OSError:
                if time.time() > end:
                    raise
                time.sleep(0.05)
        options = {
            'args': ['--headless=new', '--no-sandbox', '--disable-dev-shm-usage', '--use-angle=swiftshader',
                     '--enable-unsafe-swiftshader', '--hide-scrollbars', '--user-data-dir=' + self.profile],
            'binary': shutil.which('chromium') or 'chromium'}
        made = self.ask('POST', '/session', {'capabilities': {'alwaysMatch': {
            'browserName': 'chrome', 'goog:chromeOptions': options, 'goog:loggingPrefs': {'browser': 'ALL'}}}})
        self.session = '/session/' + made['sessionId']

    def ask(self, method, path, body=None):
        request = urllib.request.Request(self.base + path, method=method,
                                         data=None if body is None else json.dumps(body).encode(),
                                         headers={'Content-Type': 'application/json'})
        try:
            with urllib.request.urlopen(request, timeout=120) as answer:
                return json.load(answer)['value']
        except urllib.error.HTTPError as error:
            raise RuntimeError(error.read().decode()[:600]) from None

    def post(self, path, body):
        return self.ask('POST', self.session + path, body)

    def run(self, script, *arguments):
        return self.post('/execute/sync', {'script': script, 'args': list(arguments)})

    def size(self, width, height, dark=False, phone=False):
        self.cdp('Emulation.setDeviceMetricsOverride', width=width, height=height, deviceScaleFactor=1, mobile=phone)
        self.cdp('Emulation.setEmulatedMedia', features=[{'name': 'prefers-color-scheme', 'value': 'dark' if dark else 'light'}])

    def cdp(self, command, **parameters):
        return self.post('/goog/cdp/execute', {'cmd': command, 'params': parameters})

    def open(self, address):
        self.post('/url', {'url': 'about:blank'})
        self.post('/url', {'url': address})
        self.wait('return window.softfem && softfem.ready')

    def wait(self, script, seconds=30, *arguments):
        end = time.time() + seconds
        while True:
            value = self.run(script, *arguments)
            if value:
                return value
            if time.time() > end:
                raise RuntimeError('after %d s still not: %s; the page says: %s' % (seconds, script, self.message()))
            time.sleep(0.05)

    def drag(self, points, hold=False, key=None):
        """The mouse is pressed at the first point, moves through all of them, and is released."""
        moves = [{'type': 'pointerMove', 'duration': 0 if k == 0 else 60, 'x': int(x), 'y': int(y), 'origin': 'viewport'}
                 for k, (x, y) in enumerate(points)]
        moves.insert(1, {'type': 'pointerDown', 'button': 0})
        if not hold:
            moves.append({'type': 'pointerUp', 'button': 0})
        self.post('/actions', {'actions': [{'type': 'pointer', 'id': 'mouse', 'parameters': {'pointerType': 'mouse'},
                                            'actions': moves}]})

    def release(self):
        self.ask('DELETE', self.session + '/actions')

    def keys(self, text):
        self.post('/actions', {'actions': [{'type': 'key', 'id': 'keys', 'actions': [
            {'type': kind, 'value': letter} for letter in text for kind in ('keyDown', 'keyUp')]}]})

    def message(self):
        return self.run('const m = document.getElementById("message");'
                        'return m.style.display === "block" ? m.textContent : ""')

    def picture(self, path):
        with open(path, 'wb') as file:
            file.write(base64.b64decode(self.ask('GET', self.session + '/screenshot')))

    def errors(self):
        return [entry for entry in self.post('/se/log', {'type': 'browser'}) if entry['level'] == 'SEVERE']

    def close(self):
        try:
            if self.session:
                self.ask('DELETE', self.session)
        finally:
            self.driver.terminate()
            self.driver.wait()
            shutil.rmtree(self.profile, ignore_errors=True)


def need(condition, text, *numbers):
    if not condition:
        raise AssertionError(text + ''.join(' %s' % (n,) for n in numbers))


def middle(b):
    return b.run('return softfem.onScreen(softfem.world.middle)')


def drop(b, name, text):
    """A file is dropped, as the browser tells the page of it."""
    b.run('''const [name, text] = arguments, data = new DataTransfer();
        data.items.add(new File([text], name));
        for (const type of ["dragover", "drop"])
            document.body.dispatchEvent(new DragEvent(type, {bubbles: true, cancelable: true, dataTransfer: data}));''',
          name, text)


def cube(size=2.0):
    """An .obj of six quadrilaterals."""
    lines = ['v %g %g %g' % (size * (k & 1), size * (k >> 1 & 1), size * (k >> 2)) for k in range(8)]
    lines += ['f ' + ' '.join(str(k + 1) for k in face)
              for face in ((0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5))]
    return '\n'.join(lines) + '\n'


# ---------------------------------------------------------------------------------------------
# tests: each takes a browser, the page's address, and where pictures go
# ---------------------------------------------------------------------------------------------


def a_drag_moves_the_body(b, page, pictures):
    b.open(page + '#scene=grab')
    b.run('softfem.run.paused = false')
    x, y = b.run('return softfem.onScreen([0, 0, 0.75])')
    b.drag([(x, y), (x + 60, y - 20), (x + 150, y - 50)], hold=True)
    b.wait('return softfem.info().time > 0.03')
    b.run('softfem.steps(20)')
    hand = b.run('return softfem.hand()')
    need(hand[0] == 1, 'the hand holds nothing')
    force = sum(f * f for f in hand[4:7]) ** 0.5
    need(1 < force < 1e5, 'the force of the hand is', force)
    at = b.run('return softfem.onScreen([arguments[0], arguments[1], arguments[2]])', *hand[1:4])
    need(at[0] > x + 60, 'the body was dragged by 150 pixels and moved by', at[0] - x)
    b.picture(os.path.join(pictures, 'grab.png'))
    b.release()
    b.wait('return softfem.hand()[0] === 0')


def a_ball_pokes(b, page, pictures):
    b.open(page + '#scene=grab')
    b.keys('p')
    x, y = b.run('return softfem.onScreen([0, 0, 0.4])')
    b.drag([(x, y), (x + 5, y)], hold=True)
    hand = b.wait('const h = softfem.hand(); return softfem.info().contacts > 0 && Math.hypot(h[4], h[5], h[6]) > 1 && h')
    back = b.run('return softfem.shape().forward')
    need(sum(f * d for f, d in zip(hand[4:7], back)) > 0, 'the ball does not push away from the eye but along', hand[4:7])
    b.picture(os.path.join(pictures, 'poke.png'))
    b.release()
    b.wait('return softfem.hand()[0] === 0')
    b.open(page + '#scene=modes')
    b.keys('p')
    x, y = middle(b)
    b.drag([(x, y), (x + 5, y)])
    need('modal scenes have no ball' in b.message(), 'it says:', b.message())


def a_swipe_cuts_in_two(b, page, pictures):
    b.open(page + '#scene=cut')
    need(b.run('return softfem.info().pieces') == 1, 'it was broken before')
    x, y = b.run('return softfem.onScreen([0.5, 0.12, 0.12])')
    b.run('softfem.act.pause(); softfem.act.reset(); document.getElementById("cut").click()')
    b.drag([(x, y - 150)] + [(x, y - 150 + 50 * k) for k in range(1, 7)])
    need(b.run('return softfem.info().pieces') == 1, 'it broke without a step')
    b.run('softfem.act.pause()')
    b.wait('return softfem.info().large === 2')  # and crumbs, where the blade met nodes
    b.run('softfem.steps(15)')
    drawn = b.run('return softfem.drawn')
    b.wait('return softfem.drawn > arguments[0] + 1', 30, drawn)
    b.picture(os.path.join(pictures, 'cut.png'))


def a_dropped_surface_simulates(b, page, pictures):
    b.open(page)
    drop(b, 'cube.obj', cube())
    b.wait('return softfem.scene === "mesh" && softfem.info().tets > 1000')
    b.run('softfem.run.paused = false')
    b.wait('return softfem.info().time > 0.03 && softfem.info().elastic > 0')
    need('cube.obj' in b.run('return document.getElementById("message").textContent'), 'it says:', b.message())
    first = b.run('const i = softfem.info(); return [i.x1 - i.x0, i.z1]')
    need(abs(first[0] - 1) < 1e-9 and abs(first[1] - 1) < 0.01, 'it is not 1 m large but', first)
    b.picture(os.path.join(pictures, 'dropped.png'))


def other_files_simulate(b, page, pictures):
    """A surface of triangles and a mesh of tets, each a cube."""
    corner = [(k & 1, k >> 1 & 1, k >> 2) for k in range(8)]
    side = ((0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5))
    stl = 'solid cube\n' + ''.join(
        'facet normal 0 0 0\nouter loop\n%sendloop\nendfacet\n' % ''.join('vertex %d %d %d\n' % corner[q[k]] for k in half)
        for q in side for half in ((0, 1, 2), (0, 2, 3))) + 'endsolid cube\n'
    tet = ((0, 1, 2, 4), (3, 2, 1, 7), (5, 1, 4, 7), (6, 4, 2, 7), (1, 2, 4, 7))
    mesh = 'MeshVersionFormatted 1\nDimension 3\nVertices 8\n' + ''.join('%d %d %d 0\n' % c for c in corner)
    mesh += 'Tetrahedra 5\n' + ''.join('%d %d %d %d 0\n' % tuple(v + 1 for v in t) for t in tet) + 'End\n'
    for name, text, least, most in (('cube.stl', stl, 1000, 5000), ('cube.mesh', mesh, 5, 5)):
        b.open(page)
        drop(b, name, text)
        b.wait('return softfem.scene === "mesh" && document.getElementById("message").textContent.includes(arguments[0])', 30, name)
        tets = b.run('return softfem.info().tets')
        need(least <= tets <= most, 'tets of %s:' % name, tets)
        b.run('softfem.steps(10)')
        need(b.run('return softfem.info().elastic') > 0, 'it does not bend:', name)


def broken_files_get_a_message(b, page, pictures):
    b.open(page + '#scene=grab')
    for name, text, words in (('broken.obj', 'v 0 0 nan\nf 1 2 3\n', 'broken.obj: '), ('flat.stl', 'solid nothing\n', 'flat.stl: '),
                              ('noise.msh', '\x01\x02\x03 no mesh', 'noise.msh: '), ('empty.mesh', '', 'empty.mesh: '),
                              ('sheet.obj', 'v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n', 'sheet.obj: ')):
        drop(b, name, text)
        said = b.wait('const m = document.getElementById("message");'
                      'return m.textContent.startsWith(arguments[0]) && m.textContent', 10, words)
        need(len(said) > len(words) + 10, 'a poor message:', said)
        need(b.run('return softfem.scene') == 'grab', 'the scene before is gone after', name)
    before = b.run('return softfem.info().time')
    b.wait('return softfem.info().time > arguments[0]', 10, before)


def bad_numbers_get_a_message(b, page, pictures):
    b.open(page + '#scene=jelly')
    set_text = '''const [name, text] = arguments;
        const row = [...document.querySelectorAll(".slider")].find(r => r.querySelector("label").textContent === name);
        const field = row.querySelector("[type=text]"), before = field.value;
        field.value = text; field.dispatchEvent(new Event("change")); return [before, field.value]'''
    for name, text in (('E', 'NaN'), ('nu', '0.5'), ('h', 'Infinity'), ('gravity', 'soft'), ('tets', '')):
        before, after = b.run(set_text, name, text)
        need(b.message().startswith(name + ' is '), 'no message for', name, text, b.message())
        need(before == after, 'the slider keeps a bad number:', name, after)
    before = b.run('return softfem.info().time')
    b.wait('return softfem.info().time > arguments[0]', 10, before)
    b.run(set_text, 'E', '20000')
    need(b.run('return location.hash').endswith('E=20000'), 'the link is', b.run('return location.hash'))
    need(b.run('return softfem.info().time') > before, 'a softer material starts the scene again')


def a_link_restores_the_scene(b, page, pictures):
    b.open(page + '#scene=twist&turns=2&E=200000')
    need(b.run('return softfem.scene') == 'twist', 'another scene')
    values = b.run('return [...document.querySelectorAll(".slider")].map(r => [r.querySelector("label").textContent, '
                   'Number(r.querySelector("[type=text]").value)])')
    need(dict(values)['turns'] == 2 and dict(values)['E'] == 200000, 'the sliders are', values)
    b.open(page + '#scene=twist&turns=NaN')
    need('turns is nan' in b.message().lower(), 'it says:', b.message())
    b.open(page + '#scene=nothing')
    need('nothing' in b.message() and b.run('return softfem.scene') == 'grab', 'it says:', b.message())


def keys_and_buttons_work(b, page, pictures):
    b.open(page + '#scene=jelly')
    b.keys(' ')
    b.wait('return softfem.run.paused')
    time.sleep(0.1)
    before = b.run('return softfem.info().time')
    b.keys('n')
    after = b.run('return softfem.info().time')
    need(abs(after - before - 1 / 60) < 1e-9, 'one step is', after - before)
    b.keys('r')
    need(b.run('return softfem.info().time') == 0, 'reset did not')
    b.keys('s')
    need(b.run('return softfem.run.slow'), 'no slow motion')
    b.keys('d')
    need(b.run('return document.documentElement.dataset.theme') == 'dark', 'it is not dark')
    b.keys('2')
    need(b.run('return softfem.scene') == 'cut', 'key 2 opens', b.run('return softfem.scene'))


def fingers_grab_and_pinch(b, page, pictures):
    b.size(390, 844, phone=True)
    b.open(page + '#scene=grab')
    b.run('softfem.act.pause()')

    def finger(name, *points):
        moves = [{'type': 'pointerMove', 'duration': 0 if k == 0 else 80, 'x': int(x), 'y': int(y), 'origin': 'viewport'}
                 for k, (x, y) in enumerate(points)]
        moves.insert(1, {'type': 'pointerDown', 'button': 0})
        return {'type': 'pointer', 'id': name, 'parameters': {'pointerType': 'touch'}, 'actions': moves}

    x, y = b.run('return softfem.onScreen([0, 0, 0.4])')
    b.post('/actions', {'actions': [finger('one', (x, y), (x + 30, y), (x + 60, y))]})
    need(b.run('return softfem.hand()[0]') == 1, 'a finger takes hold of nothing')
    b.release()
    need(b.run('return softfem.hand()[0]') == 0, 'a finger does not let go')
    before = b.run('return softfem.camera.distance')
    b.post('/actions', {'actions': [finger('one', (100, 600), (60, 560)), finger('two', (260, 700), (330, 760))]})
    b.release()
    need(b.run('return softfem.camera.distance') < 0.9 * before, 'two fingers apart do not come nearer')
    b.size(760, 560)


def hashes_are_those_of_the_native_program(b, page, pictures):
    expected = dict(line.split() for line in NATIVE.communicate(timeout=300)[0].splitlines())
    for simd in (1, 0):
        b.open(page + '?simd=%d' % simd)
        need(b.run('return softfem.simd') == bool(simd), 'SIMD is', not simd)
        for name in HASHED if simd else HASHED_PLAIN:
            scene, _, slider = name.partition(':')
            slider, _, value = slider.partition('=')
            found = b.run('softfem.run.paused = true; softfem.open(...arguments); softfem.steps(300); return softfem.hash()',
                          scene, slider, float(value or 0))
            need(found == expected.get(name), 'the hash of %s is' % name, found, 'not', expected.get(name))


def it_looks_well(b, page, pictures):
    """Takes pictures to be looked at. What can be told of them: the theme, and that all is on the screen."""
    for name, scene, steps, width, height, dark, phone in (
            ('wide-light', 'tear', 60, 1280, 800, False, False), ('wide-dark', 'jelly', 40, 1280, 800, True, False),
            ('narrow-light', 'grab', 20, 390, 844, False, True), ('narrow-dark', 'modes', 20, 390, 844, True, True)):
        b.size(width, height, dark, phone)
        b.open(page + '#scene=' + scene)
        drawn = b.run('softfem.act.pause(); softfem.steps(arguments[0]); return softfem.drawn', steps)
        b.wait('return softfem.drawn > arguments[0] + 1', 30, drawn)
        b.picture(os.path.join(pictures, name + '.png'))
        need(b.run('return document.documentElement.dataset.theme') == ('dark' if dark else 'light'), 'the theme')
        need(b.run('return document.documentElement.scrollWidth') <= width, 'it is wider than the screen')
        need(b.run('''const out = [...document.querySelectorAll("#bottom button")].filter(x => x.offsetWidth).map(x => x.getBoundingClientRect());
            return out.every(r => r.left >= 0 && r.right <= innerWidth && r.bottom <= innerHeight)'''), 'a button is off the screen')
    b.run('document.getElementById("more").click()')
    need(b.run('const r = document.getElementById("panel").getBoundingClientRect();'
               'return r.height > 100 && r.left >= 0 && r.right <= innerWidth'), 'no sliders on a phone')
    b.picture(os.path.join(pictures, 'narrow-sliders.png'))
    b.size(760, 560)


TESTS = [a_drag_moves_the_body, a_ball_pokes, a_swipe_cuts_in_two, a_dropped_surface_simulates, other_files_simulate, broken_files_get_a_message,
         bad_numbers_get_a_message, a_link_restores_the_scene, keys_and_buttons_work, fingers_grab_and_pinch, it_looks_well,
         hashes_are_those_of_the_native_program]


def main():
    page, program = 'file://' + os.path.abspath(sys.argv[1]), os.path.abspath(sys.argv[2])
    only = sys.argv[3:]
    pictures = os.path.join(os.path.dirname(os.path.abspath(sys.argv[1])), 'pictures')
    os.makedirs(pictures, exist_ok=True)
    for tool in ('chromium', 'chromedriver'):
        if not shutil.which(tool):
            sys.exit('test-web needs %s: apt-get install chromium chromium-driver' % tool)
    global NATIVE  # runs beside the browser
    NATIVE = subprocess.Popen([program] + HASHED, stdout=subprocess.PIPE, text=True)
    failed = 0
    with open(os.path.join(pictures, 'chromedriver.log'), 'w', encoding='utf-8') as log:
        browser = Browser(log)
        try:
            browser.size(760, 560)
            for test in TESTS:
                if only and test.__name__ not in only:
                    continue
                begin = time.time()
                try:
                    test(browser, page, pictures)
                    errors = browser.errors()
                    need(not errors, 'the console has errors:', errors)
                    print('ok      %s, %.1f s' % (test.__name__, time.time() - begin), flush=True)
                except (AssertionError, RuntimeError) as error:
                    failed += 1
                    browser.size(760, 560)
                    print('FAILED  %s: %s' % (test.__name__, error), flush=True)
        finally:
            browser.close()
    print('pictures: ' + pictures)
    sys.exit(failed and 'FAILED: %d of the page\'s tests' % failed)


if __name__ == '__main__':
    main()
