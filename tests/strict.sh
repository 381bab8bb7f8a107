#!/bin/sh
# The header without a single warning: gcc and clang, C99 to C++20, every switch in C99 and C++11; and no symbol in
# the object but sfem_*. `make strict` calls this; COMPILERS="gcc" limits it.
#
# Each of compilers x standards x switches builds two files that share the header: impl.c defines
# the implementation twice, user.c includes the header twice and calls it. Both are linked and run.
# The switches that leave parts out are checked by -fsyntax-only, which takes a third of the time, but for four builds.
set -u
cd "$(dirname "$0")/.." || exit 1
BUILD=${BUILD:-build/strict}
COMPILERS=${COMPILERS:-gcc clang}
STANDARDS='c99 c11 c17 c++11 c++17 c++20'
SWITCHES='plain SFEM_STATIC O2 O3 m32 openmp SFEM_NO_STDIO SFEM_NO_DISPATCH'
PARTS='SFEM_NO_MESHIO SFEM_NO_MESHER SFEM_NO_EMBED SFEM_NO_BODY SFEM_NO_DAMAGE SFEM_NO_NEWTON SFEM_NO_SMOOTH SFEM_NO_CONTACT
    SFEM_NO_LINK SFEM_NO_REDUCED SFEM_NO_MODES SFEM_NO_MODEL SFEM_MINIMAL SFEM_ENABLE_MESHIO SFEM_ENABLE_MESHER SFEM_ENABLE_EMBED
    SFEM_ENABLE_MODEL SFEM_ENABLE_BODY SFEM_ENABLE_DAMAGE SFEM_ENABLE_NEWTON SFEM_ENABLE_SMOOTH SFEM_ENABLE_CONTACT
    SFEM_ENABLE_MODES SFEM_ENABLE_REDUCED SFEM_ENABLE_LINK SFEM_DEF'
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
    SFEM_NO_REDUCED) echo -DSFEM_NO_REDUCED -DSFEM_NO_LINK ;;
    SFEM_ENABLE_*) echo -DSFEM_MINIMAL "-D$1" ;;
    SFEM_DEF) echo '-DSFEM_DEF=__attribute__((visibility("hidden")))' ;;
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

# whole COMPILER STANDARD SWITCH: is it built, linked and run, or is only its syntax checked?
whole() {
    case $3-$1-$2 in # of C++ and of C17 the optimiser sees what it sees of C++17 and C11
    plain-*-c17 | plain-*-c++20 | SFEM_STATIC-*-c++11 | SFEM_NO_STDIO-*-c++11 | SFEM_NO_DISPATCH-*-c++11 | openmp-*-c++11) return 1 ;;
    esac
    case $3-$1-$2 in
    SFEM_ENABLE_BODY-gcc*-c99 | SFEM_ENABLE_CONTACT-gcc*-c99 | SFEM_NO_MESHIO-clang*-c99 | SFEM_ENABLE_REDUCED-clang*-c++11) return 0 ;;
    esac
    for part in $PARTS; do
        [ "$part" != "$3" ] || return 1
    done
}

# lacks OUT COMPILER STANDARD: a file that uses a part which the implementation was compiled without does not link
lacks() {
    $(command_for "$2" "$3") -I. -c -o "$1-more.o" "$BUILD/user.c" || return 1
    if $link -o "$1-more" "$1-more.o" "$1-impl.o" -lm 2>"$1-more.log"; then
        echo 'links without a part that it uses'; return 1
    fi
    grep -q sfem_mesh_parse "$1-more.log" && rm -f "$1-more.o" "$1-more.log"
}

# plays OUT COMPILER STANDARD: a player loads what the whole library has saved, and ends where that does, to the bit
plays() {
    $(command_for "$2" "$3") -I. -o "$1-whole" "$BUILD/user.c" "$BUILD/impl.c" -lm && "$1-whole" "$1.reduced" &&
        "$1" "$1.reduced" && rm -f "$1-whole" "$1.reduced"
}

one() { # COMPILER STANDARD SWITCH
    compile="$(command_for "$1" "$2") $(switch_flags "$3") -I."
    link="$(command_for "$1" "$2" | cut -d' ' -f1) $(switch_flags "$3")"
    out=$BUILD/$1-$2-$3
    if ! whole "$1" "$2" "$3"; then
        $compile -fsyntax-only "$BUILD/impl.c" >"$out.log" 2>&1 ||
            { echo "FAILED: $1 $2 $3"; head -n 40 "$out.log"; return 1; }
        return
    fi
    {
        $compile -c -o "$out-impl.o" "$BUILD/impl.c" &&
        $compile -c -o "$out-user.o" "$BUILD/user.c" &&
        symbols "$out-impl.o" "$3" &&
        if [ "$3" = SFEM_STATIC ]; then # the user's file holds the implementation, too
            $compile -DSOFTFEM_IMPLEMENTATION -DCALL -c -o "$out-user.o" "$BUILD/user.c"
        fi &&
        $link -o "$out" "$out-user.o" "$out-impl.o" -lm &&
        "$out" &&
        if [ "$3" = SFEM_ENABLE_BODY ]; then lacks "$out" "$1" "$2"; fi &&
        if [ "$3" = SFEM_ENABLE_REDUCED ]; then plays "$out" "$1" "$2"; fi
    } >"$out.log" 2>&1 || { echo "FAILED: $1 $2 $3"; head -n 40 "$out.log"; return 1; }
    rm -f "$out" "$out-impl.o" "$out-user.o"
}

if [ $# = 3 ]; then one "$@" || exit 255; exit; fi # 255: xargs starts no more

mkdir -p "$BUILD"
printf '%s\n' '#define SOFTFEM_IMPLEMENTATION' '#include "softfem.h"' \
    '#define SOFTFEM_IMPLEMENTATION' '#include "softfem.h"' >"$BUILD/impl.c"
cat >"$BUILD/user.c" <<'END'
#include <stdio.h>
#include <string.h>
#include "softfem.h"
#include "softfem.h"
#if defined(SFEM_STATIC) && !defined(CALL)
int main(void) { return 0; }
#else
static int reads(sfem_mesh *mesh)
{
#ifndef SFEM_NO_MESHIO
    static const char text[] = "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n4\n1 0 0 0\n2 1 0 0\n"
        "3 0 1 0\n4 0 0 1\n$EndNodes\n$Elements\n1\n1 4 0 1 2 3 4\n$EndElements\n";
    if (sfem_mesh_parse(text, sizeof text - 1, 0, mesh, 0) != SFEM_OK || mesh->tets != 1) return 0;
    sfem_mesh_free(mesh);
#endif
    (void)mesh;
    return 1;
}

static int makes(sfem_mesh *mesh) /* tets of a surface */
{
#ifndef SFEM_NO_MESHER
    static sfem_real x[] = {0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1};
    static sfem_int tri[] = {0, 2, 1, 0, 1, 3, 1, 2, 3, 0, 3, 2};
    sfem_mesher_def def = sfem_default_mesher_def();
    sfem_surface surface = {0};
    surface.x = x;
    surface.nodes = surface.triangles = 4;
    surface.tri = tri;
    def.size = 0.2;
    if (sfem_mesh_from_surface(&def, &surface, mesh, 0, 0) != SFEM_OK || mesh->tets < 4) return 0;
    sfem_mesh_free(mesh);
#endif
    (void)mesh;
    return 1;
}

static int follows(const sfem_mesh *mesh) /* a point that a mesh takes along */
{
#ifndef SFEM_NO_EMBED
    static const sfem_real x[3] = {0.5, 0.5, 0.5};
    sfem_embed_def def = sfem_default_embed_def();
    sfem_embed *embed = 0;
    int good;
    def.points = 1;
    def.x = x;
    good = sfem_embed_create(mesh, &def, &embed, 0) == SFEM_OK && sfem_embed_get_info(embed).outside == 0;
    sfem_embed_free(embed);
    return good;
#else
    return mesh->tets > 0;
#endif
}

#ifndef SFEM_NO_REDUCED
enum { MODES = 3, BLOCK = 1 << 16 };

/* Steps what a block holds, and whether its coordinates are then those that stand in the file, or writes them there. */
static int plays(const void *block, size_t bytes, FILE *file, int writes)
{
    static const sfem_real weight[3] = {0, 0, -9.81};
    sfem_modal_def def = sfem_default_modal_def();
    sfem_reduced *reduced = 0;
    sfem_modal *modal = 0;
    sfem_real q[MODES];
    int good, k;
    if (sfem_reduced_load(block, bytes, 0, &reduced, 0) != SFEM_OK) return 0;
    good = sfem_modal_create(reduced, &def, &modal, 0) == SFEM_OK && sfem_modal_set_gravity(modal, weight, 0) == SFEM_OK;
    for (k = 0; k < 10; ++k) good &= sfem_modal_step(modal, 0.01, 0) == SFEM_OK;
    if (file && writes) good &= fwrite(sfem_modal_coordinates(modal), sizeof q, 1, file) == 1;
    if (file && !writes)
        good &= fread(q, sizeof q, 1, file) == 1 && !memcmp(q, sfem_modal_coordinates(modal), sizeof q) && q[0] != 0;
    sfem_modal_free(modal);
    sfem_reduced_free(reduced);
    return good;
}
#endif

/* a modal body: its reduced model is made, and written to path if there is one, or else read from there */
static int bends(struct sfem_model *model, const char *path)
{
    int good = 1;
#ifndef SFEM_NO_REDUCED
    static unsigned char block[BLOCK];
    size_t bytes = 0;
#ifndef SFEM_NO_MODES
    static const sfem_int pins[] = {0, 1, 2, 3};
    FILE *file = path ? fopen(path, "wb") : 0;
    sfem_modes_def modes_def = sfem_default_modes_def();
    sfem_reduced_def def = sfem_default_reduced_def();
    sfem_modes modes;
    sfem_reduced *reduced = 0;
    modes_def.modes = MODES;
    modes_def.pins = pins;
    modes_def.pin_count = 4;
    if (sfem_modes_create(model, &modes_def, &modes, 0) != SFEM_OK ||
        sfem_reduced_create(model, &modes, &def, &reduced, 0) != SFEM_OK) return 0;
    bytes = sfem_reduced_size(reduced);
    if (bytes > sizeof block) return 0;
    sfem_reduced_save(reduced, block);
    sfem_reduced_free(reduced);
    sfem_modes_free(&modes);
    if (file) good &= fwrite(&bytes, sizeof bytes, 1, file) == 1 && fwrite(block, bytes, 1, file) == 1;
    good &= plays(block, bytes, file, 1);
#else
    FILE *file = path ? fopen(path, "rb") : 0;
    sfem_reduced *none = 0;
    if (!file) return !path && sfem_reduced_load(block, sizeof block, 0, &none, 0) == SFEM_FORMAT;
    good &= fread(&bytes, sizeof bytes, 1, file) == 1 && bytes <= sizeof block && fread(block, bytes, 1, file) == 1 &&
            plays(block, bytes, file, 0);
#endif
    if (file) fclose(file);
#endif
    (void)model, (void)path;
    return good;
}

#ifndef SFEM_NO_MODEL
#ifndef SFEM_NO_BODY
/* a part that is left out is refused when a body asks for it */
static int breaks(sfem_model *model)
{
    sfem_body_def def = sfem_default_body_def();
    sfem_body *body = 0;
#ifdef SFEM_NO_DAMAGE
    def.damage = (const struct sfem_damage_def *)(const void *)&def; /* not read */
    return sfem_body_create(model, &def, &body, 0) == SFEM_BAD_ARGUMENT;
#else
    const sfem_damage_def damage = sfem_default_damage_def();
    int good;
    def.damage = &damage;
    if (sfem_body_create(model, &def, &body, 0) != SFEM_OK) return 0;
    good = sfem_body_step(body, 0.01, 0) == SFEM_OK && sfem_body_fracture(body).pieces == 1;
    sfem_body_free(body);
    return good;
#endif
}

static int iterates(sfem_model *model)
{
    sfem_body_def def = sfem_default_body_def();
    sfem_body *body = 0;
    int good;
    def.integrator = SFEM_BACKWARD_EULER;
#ifdef SFEM_NO_NEWTON
    if (sfem_body_create(model, &def, &body, 0) != SFEM_BAD_ARGUMENT) return 0;
    def.integrator = SFEM_PQR;
    if (sfem_body_create(model, &def, &body, 0) != SFEM_OK) return 0;
    good = sfem_body_solve_static(body, 0) == SFEM_BAD_ARGUMENT;
#else
    if (sfem_body_create(model, &def, &body, 0) != SFEM_OK) return 0;
    good = sfem_body_step(body, 0.01, 0) == SFEM_OK && sfem_body_newton(body).converged;
#endif
    sfem_body_free(body);
    return good;
}
#endif

static int steps(sfem_model *model)
{
    int good = sfem_model_total_mass(model) > 0;
#ifndef SFEM_NO_BODY
    sfem_body_def def = sfem_default_body_def();
    sfem_body *body = 0;
    good &= sfem_body_create(model, &def, &body, 0) == SFEM_OK && sfem_body_step(body, 0.01, 0) == SFEM_OK;
#ifndef SFEM_NO_CONTACT
    {
        const sfem_obstacle_def floor = sfem_default_obstacle_def();
        sfem_contact *contact = 0;
        good &= sfem_contact_create(0, &contact, 0) == SFEM_OK &&
                sfem_contact_add_body(contact, body, 0, 1, 0, 0) == SFEM_OK &&
                sfem_contact_add_obstacle(contact, &floor, 0, 0) == SFEM_OK &&
                sfem_contact_step(contact, 0.01, 0) == SFEM_OK;
        sfem_contact_free(contact);
    }
#endif
    sfem_body_free(body);
    good &= breaks(model) && iterates(model);
#endif
    return good;
}
#endif

int main(int count, char **argument)
{
    const sfem_int cells[3] = {2, 1, 1};
    const sfem_real size[3] = {2, 1, 1};
    const char *path = count > 1 ? argument[1] : 0;
    sfem_mesh mesh;
    int good = reads(&mesh) && makes(&mesh);
    if (sfem_mesh_block(cells, size, SFEM_CELL_5_TETS, 0, &mesh, 0) != SFEM_OK) return 1;
    good &= follows(&mesh);
#ifndef SFEM_NO_MODEL
    {
        sfem_model_def def = sfem_default_model_def();
        sfem_model *model;
        def.mesh = &mesh;
        def.material.law = SFEM_COROTATIONAL;
        if (sfem_model_create(&def, &model, 0) != SFEM_OK) return 1;
        good &= steps(model) && bends(model, path);
        sfem_model_free(model);
        def.material.tet = SFEM_TET_SMOOTH;
#ifdef SFEM_NO_SMOOTH
        good &= sfem_model_create(&def, &model, 0) == SFEM_BAD_ARGUMENT;
#else
        if (sfem_model_create(&def, &model, 0) != SFEM_OK) return 1;
        good &= sfem_model_smooth_info(model).patches > 0;
        sfem_model_free(model);
#endif
    }
#else
    good &= bends(0, path);
#endif
#ifndef SFEM_NO_LINK
    good &= sfem_default_link_def().modes == 0;
#endif
    sfem_mesh_free(&mesh);
    return !good;
}
#endif
END

# switches that contradict each other are refused with a sentence
for compiler in $COMPILERS; do
    command=$(command_for "$compiler" c99) || continue
    for switches in SFEM_NO_REDUCED 'SFEM_NO_MODEL -DSFEM_ENABLE_MODES' 'SFEM_NO_MODEL -DSFEM_ENABLE_BODY' \
        'SFEM_NO_MODEL -DSFEM_ENABLE_SMOOTH' 'SFEM_ENABLE_SMOOTH -DSFEM_NO_SMOOTH' 'SFEM_ENABLE_CONTACT -DSFEM_NO_BODY' \
        'SFEM_ENABLE_EMBED -DSFEM_NO_EMBED' 'SFEM_ENABLE_LINK -DSFEM_NO_LINK' 'SFEM_ENABLE_BODY -DSFEM_NO_BODY' 'SFEM_ENABLE_DAMAGE -DSFEM_NO_BODY' \
        'SFEM_ENABLE_DAMAGE -DSFEM_NO_DAMAGE' 'SFEM_ENABLE_NEWTON -DSFEM_NO_NEWTON' 'SFEM_ENABLE_MESHER -DSFEM_NO_MESHER' \
        'SFEM_MINIMAL -DSFEM_ENABLE_MODES -DSFEM_NO_MODES' 'SFEM_ENABLE_MODEL -DSFEM_NO_MODEL' \
        'SFEM_STATIC -DSFEM_DEF='; do
        $command -I. -E -D$switches -o /dev/null "$BUILD/user.c" 2>&1 | grep -q 'error.*softfem[.]h: .* define ' ||
            { echo "FAILED: $compiler accepts $switches"; exit 1; }
    done
done

# what is there to compile with
jobs=$BUILD/jobs
: >"$jobs"
for compiler in $COMPILERS; do
    for standard in $STANDARDS; do
        command=$(command_for "$compiler" "$standard") || {
            echo "left out: $compiler $standard is not installed"; continue; }
        for switch in $SWITCHES $PARTS; do
            case $switch-$standard in # the switches matter less between standards than to each
            plain-* | *-c99 | *-c++11) ;;
            *) continue ;;
            esac
            case $switch-$compiler-$standard in # warnings of the optimiser do not depend on the language, clang's not on -O3
            O3-clang* | O3-gcc-c99 | O2-gcc-c++11) continue ;;
            esac
            case $compiler-$standard in # what is left over of a part is unused in each language and compiler
            gcc-c++11 | clang-c99) whole "$compiler" "$standard" "$switch" || continue ;;
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
JOBS=${JOBS:-$(nproc 2>/dev/null || echo 2)}
xargs -P "$JOBS" -n 3 sh tests/strict.sh <"$jobs" || exit 1

# everything else that is C, as the Makefile compiles it
for compiler in $COMPILERS; do
    command=$(command_for "$compiler" c99) || continue
    for file in examples/*.c tests/test_*.c bench/*.c; do
        [ -f "$file" ] || continue
        case $file in tests/*) [ -f /usr/include/cmocka.h ] || continue ;; esac
        echo "$file"
    done | xargs -P "$JOBS" -I@ sh -c "$command -fsyntax-only -I. '-DSFEM_BENCH_FLAGS=\"\"' @ ||
        { echo 'FAILED: $compiler @'; exit 255; }" || exit 1
done
echo "no warning in $(wc -l <"$jobs") builds"
