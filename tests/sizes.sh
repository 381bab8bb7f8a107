#!/bin/sh
# What each part of the header costs: bytes of code and data in the object, and processor time of the compiler (user
# and system, so that other programs on the machine matter little), at -O2. `make sizes` calls this; CC is the compiler.
set -u
cd "$(dirname "$0")/.." || exit 1
BUILD=${BUILD:-build/sizes}
CC=${CC:-gcc}
mkdir -p "$BUILD"

# row TEXT FLAGS...: compiles with the flags and prints a line
row() {
    text=$1
    shift
    # the last line of `times` is what the children of this subshell took
    took=$(
        $CC -std=c99 -O2 -DSOFTFEM_IMPLEMENTATION "$@" -c -o "$BUILD/softfem.o" -x c softfem.h >&2 || exit 1
        times
    ) || { echo "FAILED: $text"; exit 1; }
    took=$(echo "$took" | awk -F'[ms ]+' 'END { printf "%.1f", 60 * ($1 + $3) + $2 + $4 }')
    size "$BUILD/softfem.o" | awk -v text="$text" -v took="$took" \
        'NR == 2 { printf "%-44s %7.1f kB %6.1f s\n", text, ($1 + $2) / 1000, took }'
}

$CC --version | head -n 1
row 'everything'
echo 'left out'
row '  SFEM_NO_MESHIO' -DSFEM_NO_MESHIO
row '  SFEM_NO_MESHER' -DSFEM_NO_MESHER
row '  SFEM_NO_EMBED' -DSFEM_NO_EMBED
row '  SFEM_NO_DAMAGE' -DSFEM_NO_DAMAGE
row '  SFEM_NO_NEWTON' -DSFEM_NO_NEWTON
row '  SFEM_NO_SMOOTH' -DSFEM_NO_SMOOTH
row '  SFEM_NO_CONTACT' -DSFEM_NO_CONTACT
row '  SFEM_NO_BODY (and DAMAGE, NEWTON, CONTACT)' -DSFEM_NO_BODY
row '  SFEM_NO_LINK' -DSFEM_NO_LINK
row '  SFEM_NO_REDUCED (and LINK)' -DSFEM_NO_REDUCED -DSFEM_NO_LINK
row '  SFEM_NO_MODES' -DSFEM_NO_MODES
row '  SFEM_NO_MODEL (and BODY, MODES)' -DSFEM_NO_MODEL
echo 'uses, beside everything'
row '  a body: SFEM_MINIMAL, SFEM_ENABLE_BODY' -DSFEM_MINIMAL -DSFEM_ENABLE_BODY
row '  and contact: .., SFEM_ENABLE_CONTACT' -DSFEM_MINIMAL -DSFEM_ENABLE_CONTACT
row '  a modal player: .., SFEM_ENABLE_REDUCED' -DSFEM_MINIMAL -DSFEM_ENABLE_REDUCED
row '  what makes its models: .., SFEM_ENABLE_MODES' -DSFEM_MINIMAL -DSFEM_ENABLE_REDUCED -DSFEM_ENABLE_MODES
row '  the player and SFEM_NO_DISPATCH' -DSFEM_MINIMAL -DSFEM_ENABLE_REDUCED -DSFEM_NO_DISPATCH
