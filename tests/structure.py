#!/usr/bin/env python3
"""What can be checked of the structure of softfem.h without compiling it.

    python3 tests/structure.py [--list] [--self-test] [softfem.h]

Prints a table of counts, with --list also the names behind them, and exits 1 if a check fails. The header is laid
out by hand so that little parsing is needed: definitions begin in column 0, sections begin with a marker.
"""
import argparse
import bisect
import collections
import glob
import os
import re
import sys

TOP = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
SCREEN = 60      # lines of a function
PARAMETERS = 7   # of a function
TASKS = 45       # lines of the table of functions by task

# What is allowed because it is there. None of it may grow: an entry that is no longer needed is a failure, too, until
# it is taken out of here or lowered.

# Where a body's method may depend on the integrator's name, and how often: in functions that its creation calls.
INTEGRATOR = {
    'sfem_default_body_def': 1,
    'sfemi_implicit_check': 3,
    'sfemi_alpha_translate': 5,
    'sfemi_method_weigh': 4,
    'sfemi_method_choose': 4,
    'sfemi_body_check': 2,
}

# What is used above the section that defines it, and how often.
LATER = {}

# Declarations ahead of the definition: a model lists its factors.
FORWARD = {'sfem_factor': 1}

NAME = r'[A-Za-z_]\w*'
Definition = collections.namedtuple('Definition', 'name kind line end parameters section public')


def blank(match):
    return re.sub(r'[^\n\\]|\\(?!\n)', ' ', match.group())  # a comment may stand in a macro of several lines


def code_of(text):
    """The text without comments and literals; every line and column stays where it is."""
    pattern = r'/\*.*?\*/|//[^\n]*|"(?:\\.|[^"\\\n])*"|\'(?:\\.|[^\'\\\n])*\''
    return re.sub(pattern, blank, text, flags=re.S)


def without_preprocessor(code):
    return re.sub(r'^[ \t]*#(?:[^\n]*\\\n)*[^\n]*', lambda m: re.sub(r'[^\n]', ' ', m.group()), code, flags=re.M)


class Header:
    def __init__(self, text):
        self.text = text
        self.code = code_of(text)
        self.plain = without_preprocessor(self.code)
        self.lines = self.plain.split('\n')
        self.starts = [0]
        for line in self.text.split('\n'):
            self.starts.append(self.starts[-1] + len(line) + 1)
        # sections: (first line, name), a line counted from 0
        self.sections = [(text.count('\n', 0, m.start()), m.group(1))
                         for m in re.finditer(r'(?<=^/\* )=+\n \* >>([a-z-]+)(?= )', text, flags=re.M)]
        names = [name for _, name in self.sections]
        self.first = names.index('base') if 'base' in names else 0
        self.definitions = []
        self.forward = []  # (name, line) of declarations in the implementation
        self.declared = {}  # public name: line, in the API part
        self.read()

    def line_of(self, at):
        return bisect.bisect_right(self.starts, at) - 1

    def section(self, line):
        """The number of the section in which a line stands, -1 above the first one."""
        low = -1
        for k, (begin, _) in enumerate(self.sections):
            if begin > line:
                break
            low = k
        return low

    def name_of(self, section):
        return '>>' + self.sections[section][1] if section >= 0 else 'the top'

    def read(self):
        """Splits the file scope into declarations, each from column 0 to its ; or }."""
        plain = re.sub(r'extern\s+ \s*\{', blank, self.plain)  # extern "C" {, without its string
        depth, begin, at, body = 0, None, 0, None
        for at, c in enumerate(plain):
            if begin is None:
                if c in ' \t\n}':
                    continue
                begin = at
            if c in '{(':
                if c == '{' and depth == 0:
                    body = at
                depth += 1
            elif c in '})':
                depth -= 1
                if depth == 0 and c == '}' and body is not None:
                    head = plain[begin:body]
                    if re.search(r'\)\s*$', head) and not head.startswith('typedef'):  # a function; else a ; follows
                        self.declaration(begin, body, at)
                        begin = body = None
                if depth == 0 and c == ')' and re.match(r'SFEMI_\w+\(', plain[begin:at]) and \
                        re.match(r'\)[ \t]*\n', plain[at:at + 80]):
                    self.macro_call(begin, at)
                    begin = None
            elif c == ';' and depth == 0:
                self.declaration(begin, body, at)
                begin = body = None

    def add(self, name, kind, begin, end, parameters=0, public=False):
        line = self.line_of(begin)
        last = self.line_of(end)
        self.definitions.append(Definition(name, kind, line, last, parameters, self.section(line), public))

    def macro_call(self, begin, end):
        """SFEMI_SOMETHING(...) at file scope defines what it names for the first time, or is an attribute."""
        known = {d.name for d in self.definitions}
        for name in re.findall(r'\bsfemi_\w+', self.plain[begin:end]):
            if name not in known:
                self.add(name, 'macro call', begin, end)

    def declaration(self, begin, body, end):
        head = self.plain[begin:body if body is not None else end].strip()
        inside = self.plain[body:end] if body is not None else ''
        public = head.startswith('SFEM_DEF')
        api = self.section(self.line_of(begin)) < self.first
        if head.startswith('typedef'):
            pointer = re.search(r'\(\*\s*(%s)\)' % NAME, head)
            whole = re.sub(r'__attribute__\s*\(\(.*?\)\)\s*$', '', self.plain[begin:end], flags=re.S)
            last = re.search(r'(%s)\s*\)?\s*(?:\[[^\]]*\]\s*)*$' % NAME, whole)
            self.add(pointer.group(1) if pointer else last.group(1), 'type', begin, end)
        if re.match(r'(typedef\s+)?(struct|union|enum)\b', head):
            tag = re.match(r'(?:typedef\s+)?(struct|union|enum)\b\s*(SFEMI_KERNEL\(\w+\)|%s)?' % NAME, head)
            if body is not None and tag.group(2):
                self.add(tag.group(2), 'tag', begin, end)
            elif body is None and tag.group(2) and not api:
                self.forward.append((tag.group(2), str(self.line_of(begin) + 1)))
            if tag.group(1) == 'enum' and body is not None:
                for name in re.findall(r'(?:^|[{,])\s*(%s)' % NAME, re.sub(r'\([^()]*\)', '', inside)):
                    self.add(name, 'constant', begin, end)
            if head.startswith('typedef') or body is None or not re.search(r'=\s*$', head):
                return
        if head.startswith('typedef'):
            return
        function = re.search(r'(SFEMI_KERNEL\(\w+\)|\b%s)\s*\(((?:[^()]|\([^()]*\))*)\)\s*$' % NAME, head)
        if function and '=' not in head:
            name = re.sub(r'SFEMI_KERNEL\((\w+)\)', r'\1', function.group(1))
            parameters = re.sub(r'\([^()]*\)', '', function.group(2)).strip()
            count = 0 if parameters in ('', 'void') else parameters.count(',') + 1
            if body is not None:
                self.add(name, 'function', begin, end, count, public)
            elif api:
                self.declared[name] = self.line_of(begin)
            elif name.startswith('sfem'):  # not an intrinsic of the compiler
                self.forward.append((name, str(self.line_of(begin) + 1)))
            return
        variable = re.search(r'(%s)\s*(?:\[[^\]]*\]\s*)*(?:=|$)' % NAME, head)
        if variable:
            self.add(variable.group(1), 'variable', begin, end)


def contents(text):
    """The sections that the list at the top names, in order."""
    top = text[text.index('CONTENTS'):text.index('#ifndef SOFTFEM_H')]
    return re.findall(r'(?<= )>>([a-z-]+)', top[:re.search(r'^ \* +TAIL', top, flags=re.M).start()])


def task_names(text):
    """The names in the table of functions by task; `_free` after `sfem_mesh_read` is sfem_mesh_free."""
    top = text[text.index('FUNCTIONS BY TASK'):]
    table = top[:top.index('\n * CONTENTS')]
    nouns = ('mesh', 'surface', 'model', 'body', 'workspace', 'modes', 'reduced', 'modal', 'sender', 'receiver', 'ldl',
             'law', 'add', 'contact')
    names, noun = [], None
    for name in re.findall(r'(?<!\w)(?:sfem)?_\w+', table):
        if name.startswith('sfem_'):
            found = re.match(r'sfem_(%s)_' % '|'.join(nouns), name)
            noun = found.group(1) if found else noun
            names.append(name)
        else:
            names.append('sfem_%s%s' % (noun, name))
    return names, table.count('\n')


def unknown_tasks(header):
    """What the table of functions by task names and the API does not have; a table that is too long, or empty."""
    names, lines = task_names(header.text)
    types = {d.name for d in header.definitions if d.kind == 'type' and d.section < header.first}
    wrong = ['%s is not declared' % name for name in names if name not in header.declared and name not in types]
    wrong += ['%s stands twice' % name for name in sorted({n for n in names if names.count(n) > 1})]
    if lines > TASKS:
        wrong.append('%d lines, at most %d' % (lines, TASKS))
    if len(names) < TASKS:
        wrong.append('only %d names' % len(names))
    return wrong


def later_uses(header):
    """(name, line and section) of names that are used above the section in which they are defined."""
    place = {}
    for d in header.definitions:
        if d.section < header.first or header.name_of(d.section) == '>>kernels':
            continue  # the API is above all; the kernels are included where they are first used
        if d.kind in ('function', 'tag', 'type', 'variable', 'constant', 'macro call'):
            place.setdefault(d.name, d.section)
    found = []
    for number, line in enumerate(header.lines):
        section = header.section(number)
        if section < header.first:
            continue
        for name in re.findall(r'\bsfemi?_\w+|\bSFEMI?_\w+', line):
            if place.get(name, -1) > section:
                found.append((name, '%d, of %s' % (number + 1, header.name_of(place[name]))))
    return found


def integrator_uses(header):
    """(function, line) of the uses of a body's integrator; modal bodies have integrators of their own."""
    functions = [d for d in header.definitions if d.kind == 'function']
    names = [name for _, name in header.sections]
    last = names.index('modes') if 'modes' in names else len(names)
    found = []
    for number, line in enumerate(header.lines):
        section = header.section(number)
        if section < header.first or section >= last:
            continue
        for _ in re.findall(r'(?:->|\.)\s*integrator\b', line):
            name = next((d.name for d in functions if d.line <= number <= d.end), 'file scope')
            found.append((name, str(number + 1)))
    return found


def against(found, allowed):
    """Of (name, where): what is there more often than allowed, and which allowances are too high."""
    places = collections.defaultdict(list)
    for name, where in found:
        places[name].append(where)
    more = ['%s: %d, allowed %d: line %s' % (name, len(at), allowed.get(name, 0), '; '.join(at))
            for name, at in places.items() if len(at) > allowed.get(name, 0)]
    fewer = ['%s: %d, allowed %d: lower it in tests/structure.py' % (name, len(places[name]), count)
             for name, count in allowed.items() if len(places[name]) < count]
    return more + fewer, ['%s: line %s' % pair for pair in found]


def unprefixed(header):
    found = []
    for d in header.definitions:
        if not re.match(r'sfemi?_|SFEMI?_', d.name):
            found.append('%d: %s' % (d.line + 1, d.name))
    for m in re.finditer(r'^[ \t]*#[ \t]*define[ \t]+(\w+)', header.code, flags=re.M):
        if not re.match(r'sfemi?_|SFEMI?_|SOFTFEM_H$', m.group(1)):
            found.append('%d: %s' % (header.code.count('\n', 0, m.start()) + 1, m.group(1)))
    return found


def words(paths):
    found = set()
    for path in paths:
        with open(path, encoding='utf-8') as file:
            found |= set(re.findall(r'\bsfem_\w+', code_of(file.read())))
    return found


def public_users(header):
    """Public functions that nobody calls, and those that tests and benches alone call."""
    outside = {kind: words(glob.glob(os.path.join(TOP, kind, '*.[ch]')) + glob.glob(os.path.join(TOP, kind, '*.cpp')))
               for kind in ('examples', 'tests', 'bench')}
    inside = set()  # in a body of a function other than its own, or in a macro
    own = {d.name: (d.line, d.end) for d in header.definitions if d.kind == 'function'}
    for number, line in enumerate(header.code.split('\n')):
        if header.section(number) < header.first:
            continue
        for name in re.findall(r'\bsfem_\w+', line):
            if name in own and not own[name][0] <= number <= own[name][1]:
                inside.add(name)
    nobody, tests = [], []
    for name in header.declared:
        if name in inside or name in outside['examples']:
            continue
        users = [kind for kind in ('tests', 'bench') if name in outside[kind]]
        (tests if users else nobody).append('%s: %s' % (name, ', '.join(users) or 'no user'))
    return nobody, tests


def check(text):
    """Rows of (what, count, allowed or None, names)."""
    header = Header(text)
    rows = []
    sections, listed = [name for _, name in header.sections], contents(text)
    differ = ['%s in the contents, %s in the file' % (a, b) for a, b in
              zip(listed + ['nothing'] * len(sections), sections + ['nothing'] * len(listed)) if a != b]
    rows.append(('contents list against the section markers', len(differ), 0, differ))
    tasks = unknown_tasks(header)
    rows.append(('names in the table by task that are none', len(tasks), 0, tasks))
    for what, found, allowed in (
            ('uses of what a later section defines', later_uses(header), LATER),
            ('forward declarations', header.forward, FORWARD),
            ('uses of a body\'s integrator', integrator_uses(header), INTEGRATOR)):
        wrong, names = against(found, allowed)
        rows.append(('%s beyond those allowed' % what, len(wrong), 0, wrong))
        rows.append(('    in all', len(found), None, names))
    wild = unprefixed(header)
    rows.append(('names without sfem_ or sfemi_', len(wild), 0, wild))
    nobody, tests = public_users(header)
    rows.append(('public functions that nothing uses', len(nobody), 0, nobody))
    rows.append(('public functions that only tests and benches use', len(tests), None, tests))
    functions = [d for d in header.definitions if d.kind == 'function']
    lengths = sorted(((d.end - d.line + 1, d.name) for d in functions if d.end - d.line >= SCREEN), reverse=True)
    rows.append(('functions of more than %d lines' % SCREEN, len(lengths), None, ['%4d %s' % x for x in lengths]))
    many = sorted(((d.parameters, d.name) for d in functions if d.parameters > PARAMETERS), reverse=True)
    rows.append(('functions of more than %d parameters' % PARAMETERS, len(many), None, ['%4d %s' % x for x in many]))
    return header, rows


def self_test(text):
    """Every check has to find a violation that is put into a copy."""
    base = {what: count for what, count, _, _ in check(text)[1]}
    marker = re.search(r'^ \* >>math .*\n \* =+ \*/\n', text, flags=re.M).end()
    late = re.search(r'^static [^;{]*?(sfemi_\w+)\([^;]*?\)\n\{', text[text.index(' * >>fem '):], flags=re.M).group(1)

    def put(code):
        return text[:marker] + code + text[marker:]

    seven = ', '.join('int a%d' % k for k in range(8))
    seeds = [
        ('names in the table', text.replace(' sfem_body_solve_static\n', ' sfem_body_solve_statics\n', 1)),
        ('names in the table', text.replace(', _release_handle', ', _drop_handle', 1)),
        ('names in the table', text.replace(' *     share memory ', ' *\n' * 20 + ' *     share memory ', 1)),
        ('contents list', re.sub(r'^ \*( +)>>fem .*\n', '', text, count=1, flags=re.M)),
        ('contents list', text.replace('\n * >>fem ', '\n * >>assembly ', 1)),
        ('uses of what a later', put('static void sfemi_seed(void) { %s(); }\n' % late)),
        ('uses of what a later', put('static int sfemi_seed(const sfem_body *b)\n{\n    return b->asleep;\n}\n')),
        ('forward declarations', put('static int sfemi_seed(int x);\n')),
        ('forward declarations', put('struct sfemi_seed;\n')),
        ('uses of a body', put('static int sfemi_seed(sfem_body *b)\n{\n    return b->def.integrator == 1;\n}\n')),
        ('uses of a body', text.replace('d->integrator ==', 'd->integrator == d->integrator ==', 1)),
        ('names without', put('static int seed(void)\n{\n    return 1;\n}\n')),
        ('names without', put('#define SEED 1\n')),
        ('names without', put('enum { SFEMI_SEED, SEED };\n')),
        ('names without', put('typedef struct seed {\n    int x;\n} sfemi_seed;\n')),
        ('names without', put('static const int seeds[2] = {1, 2};\n')),
        ('public functions that nothing', text.replace(
            'SFEM_DEF const char *sfem_status_text(',
            'SFEM_DEF int sfem_seed(void);\nSFEM_DEF const char *sfem_status_text(', 1)),
        ('functions of more than 60', put('static void sfemi_seed(void)\n{\n' + '    ;\n' * 60 + '}\n')),
        ('functions of more than 7', put('static void sfemi_seed(%s)\n{\n}\n' % seven)),
    ]
    missed = 0
    for start, seeded in seeds:
        found = {what: count for what, count, _, _ in check(seeded)[1]}
        what = next(w for w in base if w.startswith(start))
        if seeded == text or found[what] <= base[what]:
            print('a seeded violation is not found: %s' % start)
            missed += 1
    same = {what: count for what, count, _, _ in check(put('static void sfemi_seed(void) { /* %s(); */ }\n' % late))[1]}
    if same != base:
        print('a call in a comment counts')
        missed += 1
    print('self-test: %d of %d seeded violations found' % (len(seeds) - missed, len(seeds)))
    return missed


def main():
    parser = argparse.ArgumentParser(description='Checks the structure of softfem.h.')
    parser.add_argument('--list', action='store_true', help='print the names behind every count')
    parser.add_argument('--self-test', action='store_true', help='seed violations in a copy, all have to be found')
    parser.add_argument('header', nargs='?', default=os.path.join(TOP, 'softfem.h'))
    options = parser.parse_args()
    with open(options.header, encoding='utf-8') as file:
        text = file.read()
    if options.self_test:
        return 1 if self_test(text) else 0
    header, rows = check(text)
    failed = 0
    print('%d lines, %d bytes, %d sections, %d functions, %d of them public' % (
        text.count('\n'), len(text.encode('utf-8')), len(header.sections),
        sum(d.kind == 'function' for d in header.definitions), len(header.declared)))
    for what, count, allowed, names in rows:
        bad = allowed is not None and count > allowed
        failed += bad
        print('%-58s %5d  %s' % (what, count, '' if allowed is None else 'FAILED' if bad else 'ok'))
        if bad or options.list:
            for name in names:
                print('        ' + name)
    return 1 if failed else 0


if __name__ == '__main__':
    sys.exit(main())
