"""Puts page.js and two WebAssembly modules into page.html: one file without anything beside it.

    python3 examples/web/build.py SIMD.wasm PLAIN.wasm OUT.html
"""
import base64
import os
import sys

here = os.path.dirname(os.path.abspath(__file__))


def text(name):
    with open(os.path.join(here, name), encoding='utf-8') as file:
        return file.read()


def encoded(path):
    with open(path, 'rb') as file:
        return base64.b64encode(file.read()).decode()


simd, plain, out = sys.argv[1:]
page = text('page.html').replace('@SCRIPT@', text('page.js'))
page = page.replace('@SIMD@', encoded(simd)).replace('@PLAIN@', encoded(plain))
with open(out, 'w', encoding='utf-8') as file:
    file.write(page)
print('wrote %s, %.1f MB' % (out, len(page) / 1e6))
