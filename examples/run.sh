#!/bin/sh
# make run: compiles the parts of softfem.h, each for the examples that need it, runs these, and lists their pictures.
# Called by the Makefile, which sets MAKE, BUILD, JOBS and RUN, the examples.
#
# On a terminal a bar says how far it is, elsewhere a line is printed for each step that is done.
set -u
export OMP_NUM_THREADS=1 # several examples run at a time
cd "$(dirname "$0")/.." || exit 1
log=$BUILD/run/steps # a line for each step that is done: the Makefile's rules and this script add to it
mkdir -p "$BUILD/run"
: >"$log"
set -- $RUN
programs=$#
begin=$(date +%s)
[ -t 1 ] && bar=1 || bar=0

# watch PID TOTAL WHAT: prints what is done until the process ends
watch() {
    shown=0
    while :; do
        kill -0 "$1" 2>/dev/null && alive=1 || alive=0
        now=$(wc -l <"$log")
        seconds=$(($(date +%s) - begin))
        if [ $bar = 1 ]; then
            full=$((now * 30 / $2))
            [ $full -gt 30 ] && full=30
            printf '\r\033[K[%s%s] %d of %d, %d s: %s' "$(printf '%.*s' $full '##############################')" \
                "$(printf '%.*s' $((30 - full)) '..............................')" "$now" "$2" "$seconds" "$3"
        else
            tail -n +$((shown + 1)) "$log" | head -n $((now - shown)) | sed 's/^/  /'
            shown=$now
        fi
        [ $alive = 1 ] || break
        sleep 0.2
    done
    [ $bar = 0 ] || printf '\r\033[K'
    wait "$1"
}

fail() {
    cat "$1"
    echo "FAILED: $2"
    exit 1
}

case "${MAKEFLAGS%% *}" in *n*) exit 0 ;; esac # make -n
steps=$($MAKE -s -n run-programs 2>/dev/null | grep -c 'run/steps')
echo "1. compile softfem.h, part by part, and $programs examples ($JOBS compilers at a time)"
if [ "$steps" -gt 0 ]; then
    $MAKE -s --no-print-directory run-programs >"$BUILD/run/make.log" 2>&1 &
    watch $! "$steps" compiling || fail "$BUILD/run/make.log" 'the compiler'
fi
built=$(($(date +%s) - begin))
echo "   $built s"

echo "2. run them ($JOBS at a time)"
: >"$log"
rm -f "$BUILD"/run/*.failed
begin=$(date +%s)
printf '%s\n' "$@" | xargs -P "$JOBS" -n 1 sh -c '
    arguments=
    [ "$1" != fracture ] || arguments="--scene blade --quick"
    [ "$1" != gallery ] || arguments=first
    case $1 in drop | gripper) arguments=--quick ;; esac
    from=$(date +%s)
    if "$BUILD/run/$1" $arguments --out "$BUILD/$1" >"$BUILD/run/$1.log" 2>&1
    then echo "$1, $(($(date +%s) - from)) s" >>"$BUILD/run/steps"
    else touch "$BUILD/run/$1.failed"; fi' sh &
watch $! "$programs" running
for name; do [ ! -e "$BUILD/run/$name.failed" ] || fail "$BUILD/run/$name.log" "$name"; done
ran=$(($(date +%s) - begin))
echo "   $ran s"

echo "3. pictures"
for name; do
    files=$(cd "$BUILD/$name" && ls -- *.png *.svg 2>/dev/null | tr '\n' ' ')
    printf '   %-16s %s\n' "$BUILD/$name" "$files"
done
echo "compiled in $built s, ran in $ran s"
echo "open this first: $BUILD/$1/$(cd "$BUILD/$1" && ls -- *.png | head -n 1)"
