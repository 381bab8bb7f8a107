#!/bin/sh
# The header without a single warning: gcc and clang, C99 to C++20, every switch in C99 and C++11; and no symbol in
# the object but sfem_*. `make strict` calls this; COMPILERS="gcc" limits it.
#
# Each of compilers x standards x switches builds two files that share the header: impl.c defines
# the implementation twice, user.c includes the header twice and calls it. Both are linked and run.
set -u
cd "$(dirname "$0")/.." || exit 1
BUILD=${BUILD:-build/strict}
COMPILERS=${COMPILERS:-gcc clang}
STANDARDS='c99 c11 c17 c++11 c++17 c++20'
SWITCHES='plain SFEM_STATIC O2 O3 m32 openmp SFEM_NO_STDIO SFEM_NO_DISPATCH'
WARNINGS='-Werror -Wall -Wextra -Wpedantic -Wconversion -Wshadow'

# command COMPILER STANDARD: what compiles that, without files; nothing if it is not installed
command_for() {
    case $2 in
    c++*) driver=$(echo "$1" | sed 's/gcc/g++/; s/clang/clang++/')
          flags="-Wno-missing-field-initializers -x c++" ;;
    *)    driver=$1 flags='-x c' ;;
    esac
    command -v "$driver" >/dev/null && echo "$driver -std=$2 $WARNINGS $flags"
}

switch_flags() {
    case $1 in
    plain) ;;
    O2 | O3) echo "-$1" ;;
    m32) echo -m32 -mfpmath=387 ;; # where there is more than double precision in between
    openmp) echo -fopenmp ;;
    *) echo "-D$1" ;;
    esac
}

# symbols OBJECT SWITCH: complains about what the object shows or keeps; DW.ref.*, __x86.* and
# __clang_call_terminate are the compilers' own
symbols() {
    shown=$(nm -g --defined-only "$1" | awk '{ print $NF }' | grep -v -e '^DW[.]ref[.]' -e '^__clang' -e '^__x86')
    [ "$2" = SFEM_STATIC ] || shown=$(echo "$shown" | grep -v '^sfem_[a-z0-9_]*$')
    [ -z "$shown" ] || { echo "symbols that are not sfem_*:" $shown; return 1; }
    kept=$(nm "$1" | awk '$(NF-1) ~ /^[bBcC]$/ { print $NF }')
    [ -z "$kept" ] || { echo "variables that outlive a call:" $kept; return 1; }
}

one() { # COMPILER STANDARD SWITCH
    compile="$(command_for "$1" "$2") $(switch_flags "$3") -I."
    link="$(command_for "$1" "$2" | cut -d' ' -f1) $(switch_flags "$3")"
    out=$BUILD/$1-$2-$3
    {
        $compile -c -o "$out-impl.o" "$BUILD/impl.c" &&
        $compile -c -o "$out-user.o" "$BUILD/user.c" &&
        symbols "$out-impl.o" "$3" &&
        if [ "$3" = SFEM_STATIC ]; then # the user's file holds the implementation, too
            $compile -DSOFTFEM_IMPLEMENTATION -DCALL -c -o "$out-user.o" "$BUILD/user.c"
        fi &&
        $link -o "$out" "$out-user.o" "$out-impl.o" -lm &&
        "$out"
    } >"$out.log" 2>&1 || { echo "FAILED: $1 $2 $3"; head -n 40 "$out.log"; return 1; }
    rm -f "$out" "$out-impl.o" "$out-user.o"
}

if [ $# = 3 ]; then one "$@" || exit 255; exit; fi # 255: xargs starts no more

mkdir -p "$BUILD"
printf '%s\n' '#define SOFTFEM_IMPLEMENTATION' '#include "softfem.h"' \
    '#define SOFTFEM_IMPLEMENTATION' '#include "softfem.h"' >"$BUILD/impl.c"
printf '%s\n' '#include "softfem.h"' '#include "softfem.h"' \
    '#if defined(SFEM_STATIC) && !defined(CALL)' \
    'int main(void) { return 0; }' \
    '#else' \
    'int main(void)' '{' \
    '    static const char text[] = "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n4\n1 0 0 0\n2 1 0 0\n"' \
    '        "3 0 1 0\n4 0 0 1\n$EndNodes\n$Elements\n1\n1 4 0 1 2 3 4\n$EndElements\n";' \
    '    sfem_mesh mesh;' \
    '    const int failed = sfem_mesh_parse(text, sizeof text - 1, 0, &mesh, 0) != SFEM_OK || mesh.tets != 1;' \
    '    if (!failed) sfem_mesh_free(&mesh);' \
    '    return failed;' '}' \
    '#endif' >"$BUILD/user.c"

# what is there to compile with
jobs=$BUILD/jobs
: >"$jobs"
for compiler in $COMPILERS; do
    for standard in $STANDARDS; do
        command=$(command_for "$compiler" "$standard") || {
            echo "left out: $compiler $standard is not installed"; continue; }
        for switch in $SWITCHES; do
            case $switch-$standard in # the switches matter less between standards than to each
            plain-* | *-c99 | *-c++11) ;;
            *) continue ;;
            esac
            if [ "$switch" = openmp ] && ! printf '#include <omp.h>\nint main(void){return 0;}\n' |
                $command -fopenmp -o /dev/null - >/dev/null 2>&1; then
                echo "left out: $compiler $standard with OpenMP, whose omp.h is missing"; continue
            fi
            if [ "$switch" = m32 ] && ! echo 'int main(void){return 0;}' |
                $command $(switch_flags m32) -o "$BUILD/probe" - >/dev/null 2>&1; then
                echo "left out: $compiler $standard for 32 bits, whose libraries are missing"; continue
            fi
            echo "$compiler $standard $switch" >>"$jobs"
        done
    done
done
[ -s "$jobs" ] || { echo 'no compiler found'; exit 1; }

export BUILD COMPILERS
xargs -P "$(nproc 2>/dev/null || echo 2)" -n 3 sh tests/strict.sh <"$jobs" || exit 1

# everything else that is C, as the Makefile compiles it
for compiler in $COMPILERS; do
    command=$(command_for "$compiler" c99) || continue
    for file in examples/*.c tests/test_*.c bench/*.c; do
        [ -f "$file" ] || continue
        case $file in tests/*) [ -f /usr/include/cmocka.h ] || continue ;; esac
        $command -fsyntax-only -I. '-DSFEM_BENCH_FLAGS=""' "$file" ||
            { echo "FAILED: $compiler $file"; exit 1; }
    done
done
echo "no warning in $(wc -l <"$jobs") builds"
