# softfem.h. `make help` prints what there is to type.
#
# Needs GNU make and a C compiler; `test` also needs cmocka, which it installs where it may.
#
#   CC=clang        another compiler                    CFLAGS='-O3 -march=native'   other flags
#   OPENMP=0|1      without or with OpenMP; by default with it where the compiler links it
#   MESHES=DIR      meshes from elsewhere, passed to tests and benches as SFEM_MESHES; none by default
#   SURFACES=DIR    surfaces for bench-mesher
#   TESTS=test_mesh only these test programs            FILTER='*patch*'  only these tests in them
#   JOBS=N          compilers and test programs at a time, all processors by default
#   QUICK=1         a small `bench`
#   BUILD=DIR       where products go: DIR/examples/NAME, DIR/tests/NAME, DIR/bench/NAME
#
# Sources are found by pattern: examples/NAME.c, tests/test_NAME.c and bench/NAME.c are programs of
# their own, linked with the one softfem.o (examples/hello.c holds the implementation itself).
# An example understands --quick and --out DIR, which is how `test` runs it.
# FLAGS_NAME below adds flags to one program.

CFLAGS   ?= -O2 -g
CXX      ?= c++
MESHES   ?=
SURFACES ?=
BUILD    ?= build
FILTER   ?=
JOBS     ?= $(shell nproc 2>/dev/null || echo 1)
ifeq ($(MAKELEVEL),0)
MAKEFLAGS += -j$(JOBS)
endif
BEGIN := $(shell date +%s)
WARNINGS  = -Wall -Wextra -Wpedantic -Wconversion -Wshadow

FLAGS_test_base = -ffast-math

EXAMPLES := $(patsubst examples/%.c,%,$(wildcard examples/*.c))
TESTS    ?= $(patsubst tests/%.c,%,$(wildcard tests/test_*.c))
BENCHES  := $(filter-out solver step eigen,$(patsubst bench/%.c,%,$(wildcard bench/*.c)))
# test programs that hold the implementation: compiled at -O1 unless CFLAGS is given, which takes half the time (the wide
# one emulates vectors, which -O2 makes ten times as fast)
INSIDE := $(filter-out test_solver_wide,$(patsubst tests/%.c,%,$(shell grep -l '^.define SOFTFEM_IMPLEMENTATION' tests/test_*.c 2>/dev/null)))
# test programs in which a test is named after threads
THREADED := $(shell grep -l '^static void [a-z0-9_]*thread' tests/test_*.c 2>/dev/null)

EXAMPLE_PROGRAMS = $(EXAMPLES:%=$(BUILD)/examples/%)
TEST_PROGRAMS    = $(TESTS:%=$(BUILD)/tests/%)
BENCH_PROGRAMS   = $(BENCHES:%=$(BUILD)/bench/%)

# links(source, flags): 1 if the source compiles and links with the flags, else 0; asked once
links = $(shell printf '$(1)' | $(CC) $(CFLAGS) -x c - -o /dev/null $(2) >/dev/null 2>&1 \
          && echo 1 || echo 0)
OPENMP ?= $(eval OPENMP := $$(call links,int omp_get_max_threads(void); \
          int main(void){return omp_get_max_threads();},-fopenmp))$(OPENMP)

FLAGS = -std=c99 $(WARNINGS) -I. $(if $(filter 1,$(OPENMP)),-fopenmp) \
        $(CFLAGS) $(CPPFLAGS) $(INSTRUMENT)
ENVIRONMENT = SFEM_SCRATCH=$(BUILD)/scratch SFEM_FILTER='$(FILTER)' \
              $(if $(MESHES),SFEM_MESHES='$(or $(wildcard $(MESHES)),$(error MESHES=$(MESHES): no such directory))')

help: ## print this list
	@grep -E '^[a-z-]+:.*## ' Makefile | sed -E 's/^([a-z-]+):.*## (.*)/  make \1|\2/' | \
	    awk -F'|' '{ printf "%-20s %s\n", $$1, $$2 }'

RUN = gallery crush drop fracture grab gripper modes stream

run: ## bodies are torn, crushed, dropped, cut, grabbed, gripped, vibrate, are streamed: pictures in build/ in under 30 s
	+@MAKE='$(MAKE)' BUILD='$(BUILD)' JOBS='$(JOBS)' RUN='$(RUN)' sh examples/run.sh

# `run` compiles softfem.h in two parts beside each other, at -O1 unless CFLAGS is given: all of it at -O2 takes one
# processor longer than the whole run. $(BUILD)/run/steps gets a line for each step that is done.
RUN_FLAGS = $(FLAGS) $(if $(filter file,$(origin CFLAGS)),-O1 -g0)
PART_bodies = -DSFEM_MINIMAL -DSFEM_ENABLE_DAMAGE -DSFEM_ENABLE_CONTACT -DSFEM_ENABLE_MESHER
PART_modal  = -DSFEM_MINIMAL -DSFEM_ENABLE_LINK -DSFEM_ENABLE_MODES -DSFEM_ENABLE_MESHIO
part_of = $(if $(filter gallery crush drop fracture gripper,$(1)),bodies,modal)

run-programs: $(BUILD)/run/part_bodies.o $(BUILD)/run/part_modal.o $(RUN:%=$(BUILD)/run/%)

$(BUILD)/run/part_%.o: softfem.h Makefile $(BUILD)/flags
	@mkdir -p $(@D)
	@$(CC) $(RUN_FLAGS) $(PART_$*) -DSOFTFEM_IMPLEMENTATION -c -o $@ -x c softfem.h && \
	    echo 'softfem.h, $*' >>$(BUILD)/run/steps

$(BUILD)/run/%.o: examples/%.c $(wildcard examples/*.h examples/scenes/*.h) softfem.h Makefile $(BUILD)/flags
	@mkdir -p $(@D)
	@$(CC) $(RUN_FLAGS) $(PART_$(call part_of,$*)) -c -o $@ $< && echo '$<' >>$(BUILD)/run/steps

.SECONDEXPANSION:
$(RUN:%=$(BUILD)/run/%): %: %.o $$(BUILD)/run/part_$$(call part_of,$$(@F)).o
	@$(CC) $(RUN_FLAGS) -o $@ $^ $(LDFLAGS) -lm

test: check check-examples ## build and run every test, and every example once; how far it is, and its time
	@echo "make test: everything passed in $$(($$(date +%s) - $(BEGIN))) s, compilation included"

# What the report is made of, in this order; text goes to $(BUILD)/bench/NAME.txt. QUICK=1: fewer sizes, scenes and
# repetitions, within a minute once all is built.
REPORT = integrators solver eigen needs bench
QUICK ?=
ARGUMENTS_integrators = $(if $(QUICK),--quick) --out $(BUILD)/bench-integrators --references $(BUILD)/bench-real
ARGUMENTS_solver      = $(if $(QUICK),7000 10)
ARGUMENTS_eigen       = $(if $(QUICK),2500 3,20000)
ARGUMENTS_needs       = $(if $(QUICK),--quick) --out $(BUILD)/bench
ARGUMENTS_bench       = $(if $(QUICK),20000)

bench: $(REPORT:%=$(BUILD)/bench/%) ## all that the page build/bench/report.html shows; QUICK=1: within a minute
	@begin=$$(date +%s); k=0; export OMP_THREAD_LIMIT=1 OPENBLAS_NUM_THREADS=1; \
	$(foreach x,$(REPORT),k=$$((k + 1)); echo "== $$k of $(words $(REPORT)): bench/$(x)"; \
	    { $(ENVIRONMENT) $(BUILD)/bench/$(x) $(ARGUMENTS_$(x)) || echo >$(BUILD)/bench/$(x).failed; } | \
	        tee $(BUILD)/bench/$(x).txt; \
	    if [ -e $(BUILD)/bench/$(x).failed ]; then rm $(BUILD)/bench/$(x).failed; echo 'FAILED: $(x)'; exit 1; fi;) \
	echo "measured in $$(($$(date +%s) - begin)) s"
	@if command -v python3 >/dev/null; \
	then python3 bench/report.py $(BUILD)/bench $(BUILD)/bench-integrators/integrators.csv $(if $(QUICK),quick); \
	else echo 'python3, which makes $(BUILD)/bench/report.html of these figures, is not installed'; fi

bench-body: $(BUILD)/bench/bench ## set-up, factor, solve, step and memory by body size
	$(ENVIRONMENT) $(BUILD)/bench/bench

bench-needs: $(BUILD)/bench/needs ## bodies without and with one thing: what a scene pays for what it asks for
	OMP_THREAD_LIMIT=1 $(BUILD)/bench/needs --out $(BUILD)/bench

bench-embed: $(BUILD)/bench/embed ## render surfaces that follow bodies: ns a point beside memory bandwidth
	$(BUILD)/bench/embed

bench-mesher: $(BUILD)/bench/mesher ## tets from surfaces: time, angles, volume, distance, memory; files of SURFACES=DIR or SFEM_SURFACES
	$(BUILD)/bench/mesher $(if $(SURFACES),--surfaces '$(SURFACES)')

bench-sleep: $(BUILD)/bench/sleep ## a step of a sleeping body, and what watching for sleep costs
	$(ENVIRONMENT) $(BUILD)/bench/sleep

bench-contact: $(BUILD)/bench/contact ## a step in contact over one without; first touch; the worst step of a drop
	OMP_THREAD_LIMIT=1 $(BUILD)/bench/contact

bench-scalar: $(BUILD)/bench/scalar ## a matrix S (x) I by the factor of S beside that of 3x3 blocks
	$(ENVIRONMENT) $(BUILD)/bench/scalar

bench-link: $(BUILD)/bench/link ## packets of a lossy link: bytes, time, distortion against loss
	$(BUILD)/bench/link

bench-integrators: $(BUILD)/bench/integrators ## run time against error of every integrator, bars and real meshes
	OMP_THREAD_LIMIT=1 $(ENVIRONMENT) $(BUILD)/bench/integrators --out $(BUILD)/bench-integrators \
	    --references $(BUILD)/bench-real

bench-source: $(BUILD)/bench/source ## the experiments of the (p,q,r) paper, with their mistakes shown
	OMP_THREAD_LIMIT=1 $(BUILD)/bench/source --out $(BUILD)/bench-source

hash: $(BUILD)/bench/hash ## hashes of what bodies do in many scenes, to compare before and after an edit
	@OMP_THREAD_LIMIT=1 $(BUILD)/bench/hash

stress: $(BUILD)/bench/stress $(BUILD)/bench/scenes ## which integrator survives what: 488 scenes; the default has to survive all, and those of examples/scenes
	$(BUILD)/bench/stress
	$(BUILD)/bench/scenes

bench-scenes: $(BUILD)/bench/scenes ## what a step of each scene of examples/scenes takes
	$(BUILD)/bench/scenes

accuracy: $(BUILD)/bench/accuracy ## the verification table: expected beside found; CalculiX if there
	$(ENVIRONMENT) $(BUILD)/bench/accuracy --references $(BUILD)/bench-real

bench-tets: $(BUILD)/bench/accuracy ## error against run time of linear and smooth tets and CalculiX's C3D10, with a picture
	OMP_THREAD_LIMIT=1 $(BUILD)/bench/accuracy --race $(BUILD)/tets.svg

bench-solver: $(BUILD)/bench/solver ## the solver beside CHOLMOD, Eigen, METIS, BLAS where installed
	OMP_THREAD_LIMIT=1 OPENBLAS_NUM_THREADS=1 $(ENVIRONMENT) $(BUILD)/bench/solver

bench-warp: $(BUILD)/bench/warp ## modal bodies: run time against error, of a step and of warping
	$(BUILD)/bench/warp

bench-step: $(BUILD)/bench/step ## mean, median, worst step beside semi-implicit Newmark, also on CHOLMOD
	OMP_THREAD_LIMIT=1 OPENBLAS_NUM_THREADS=1 $(ENVIRONMENT) $(BUILD)/bench/step

bench-real: $(BUILD)/bench/real ## the step on real and unstructured meshes: error, rejected, time
	OMP_THREAD_LIMIT=1 $(ENVIRONMENT) $(BUILD)/bench/real --out $(BUILD)/bench-real

bench-eigen: $(BUILD)/bench/eigen ## modes beside ARPACK on CHOLMOD where installed; who lost which
	OMP_THREAD_LIMIT=1 OPENBLAS_NUM_THREADS=1 $(ENVIRONMENT) $(BUILD)/bench/eigen

examples: $(EXAMPLE_PROGRAMS) ## build every example

# Debian: clang, lld, wasi-libc, libclang-rt-14-dev-wasm32. Each of simd, plain and native is softfem.h and page.c. Without
# contraction, with portable kernels and functions of its own in place of libm's, all three compute the same bits.
WEB = $(BUILD)/web
WEB_CC ?= clang
WEB_FLAGS = -std=c99 $(WARNINGS) -Werror -I. -ffp-contract=off
WASM = --target=wasm32-wasi
WEB_simd   = $(WASM) -O2 -msimd128
WEB_plain  = $(WASM) -O1
WEB_native = -O1
WASM_LINK = $(WASM) -mexec-model=reactor -Wl,-z,stack-size=1048576 -Wl,--stack-first -Wl,--strip-all

web: $(WEB)/softfem.html ## build/web/softfem.html: scenes to play with in a browser, one file

serve: $(WEB)/softfem.html ## the same, served to browsers: http://localhost:8000/softfem.html
	cd $(WEB) && python3 -m http.server 8000

test-web: $(WEB)/softfem.html $(WEB)/native ## the page in headless Chromium, its hashes beside those of a native program
	@python3 tests/web.py $^

$(WEB)/tools:
	@mkdir -p $(@D)
	@printf '#include <stdio.h>\nint main(void){return 0;}\n' | $(WEB_CC) --target=wasm32-wasi -x c - -o $@ 2>/dev/null || \
	    { echo 'The page needs a compiler for WebAssembly. Type this, then make web again:'; \
	    echo '    sudo apt-get install clang lld wasi-libc libclang-rt-14-dev-wasm32'; exit 1; }

WEB_HEADERS = examples/web/page.h examples/web/portable_math.h softfem.h

$(WEB)/%_softfem.o: $(WEB_HEADERS) $(WEB)/tools
	$(WEB_CC) $(WEB_FLAGS) $(WEB_$*) -include examples/web/page.h -DSOFTFEM_IMPLEMENTATION -c -o $@ -x c softfem.h

$(WEB)/%_page.o: examples/web/page.c $(wildcard examples/scenes/*.h) $(WEB_HEADERS) $(WEB)/tools
	$(WEB_CC) $(WEB_FLAGS) $(WEB_$*) -c -o $@ $<

$(WEB)/%.wasm: $(WEB)/%_softfem.o $(WEB)/%_page.o
	$(WEB_CC) $(WASM_LINK) -o $@ $^

$(WEB)/native: $(WEB)/native_softfem.o $(WEB)/native_page.o
	$(WEB_CC) -o $@ $^ -lm

$(WEB)/softfem.html: $(WEB)/simd.wasm $(WEB)/plain.wasm examples/web/page.html examples/web/page.js examples/web/build.py
	python3 examples/web/build.py $(WEB)/simd.wasm $(WEB)/plain.wasm $@

gallery: $(BUILD)/examples/gallery ## the pictures of examples/gallery/, the first of them that of README.md
	$(BUILD)/examples/gallery --out examples/gallery

INTEROP ?=
INTEROP_PYTHON ?= $(firstword $(wildcard /usr/bin/python3) python3)
INTEROP_PROGRAMS = $(BUILD)/tests/interop_dump $(BUILD)/examples/simulate $(BUILD)/examples/tetrahedralize
test-interop: $(INTEROP_PROGRAMS) ## meshes to and from gmsh, TetGen, meshio, VTK, CalculiX; skips what is not installed (INTEROP=--need-all)
	@mkdir -p $(BUILD)/interop/programs
	@cp $^ $(BUILD)/interop/programs/
	@$(INTEROP_PYTHON) tests/interop.py $(BUILD)/interop/programs $(BUILD)/interop/files $(INTEROP)

strict: ## gcc and clang, C99 to C++20, every switch, no warning, no foreign symbol
	@if command -v python3 >/dev/null; then $(MAKE) -s structure; else echo 'left out: structure, which needs python3'; fi
	@BUILD=$(BUILD)/strict sh tests/strict.sh

structure: ## order of the sections, names, unused functions; long functions (names: STRUCTURE=--list)
	@python3 tests/structure.py $(STRUCTURE) && python3 tests/structure.py --self-test

sizes: ## bytes of the object and time to compile it: whole, without each part, for three uses
	@BUILD=$(BUILD)/sizes CC='$(CC)' sh tests/sizes.sh

# without the emulation of other vector paths, which would take as long as all the rest, and without the
# checks of single pointers, which the address sanitizer does for what they point at
comma := ,
SLOW = null,alignment,object-size,pointer-overflow,nonnull-attribute,returns-nonnull-attribute

asan: ## the tests under address and undefined-behaviour sanitizers
	$(MAKE) check BUILD=$(BUILD)/asan OPENMP=0 CFLAGS='-O1' \
	    TESTS='$(filter-out test_solver_wide test_solver_portable,$(TESTS))' \
	    INSTRUMENT='-fsanitize=address,undefined -fno-sanitize=$(SLOW) -fno-sanitize-recover=all'

tsan: ## the tests named after threads under the thread sanitizer (all: FILTER='*')
ifneq ($(THREADED)$(FILTER),)
	$(MAKE) check BUILD=$(BUILD)/tsan OPENMP=0 CFLAGS='-O1 -g' INSTRUMENT=-fsanitize=thread \
	    FILTER='$(or $(FILTER),*thread*)' \
	    $(if $(FILTER),,TESTS='$(filter-out test_solver_wide test_solver_portable,$(patsubst tests/%.c,%,$(THREADED)))')
else
	@echo 'no test is named after threads'
endif

# Each target by itself, from the good inputs that it makes, in FUZZ_SECONDS; what is found stays in build/fuzz.
FUZZ_SECONDS ?= 60
FUZZ_TARGETS ?= gmsh vtk vtu medit inp vega tetgen surface body modal reduced link

fuzz: $(BUILD)/fuzz/fuzz ## mesh and surface readers, state blocks and packets under libFuzzer, FUZZ_SECONDS=60 each (clang)
	@for x in $(FUZZ_TARGETS); do \
	    mkdir -p $(BUILD)/fuzz/$$x; echo "== $$x"; \
	    SFEM_FUZZ=$$x SFEM_FUZZ_SEEDS=$(BUILD)/fuzz/$$x $(BUILD)/fuzz/fuzz -verbosity=0 -timeout=20 \
	        -max_total_time=$(FUZZ_SECONDS) -print_final_stats=1 \
	        -artifact_prefix=$(BUILD)/fuzz/$$x- $(BUILD)/fuzz/$$x >$(BUILD)/fuzz/$$x.log 2>&1 || \
	        { cat $(BUILD)/fuzz/$$x.log; echo "FAILED: $$x"; exit 1; }; \
	    grep number_of_executed_units $(BUILD)/fuzz/$$x.log; \
	done

# Only the portable kernels: the others would take most of the time to compile, and read nothing from outside.
$(BUILD)/fuzz/fuzz: tests/fuzz.c tests/fuzz.h tests/mesh_files.h softfem.h
	@mkdir -p $(@D)
	clang -std=c99 $(WARNINGS) -I. -O1 -g -DSFEM_NO_DISPATCH -fsanitize=fuzzer,address,undefined \
	    -fno-sanitize=$(subst pointer-overflow$(comma),,$(SLOW)) -fno-sanitize-recover=all -o $@ $< -lm

analyze: ## static analysis by gcc, clang and cppcheck, where installed
	@mkdir -p $(BUILD)
	@for c in gcc clang; do command -v $$c >/dev/null || continue; echo "== $$c"; \
	    case $$c in gcc) a=-fanalyzer;; *) a=--analyze;; esac; \
	    $$c $$a -std=c99 -O1 $(WARNINGS) -DSOFTFEM_IMPLEMENTATION -c -x c softfem.h \
	        -o $(BUILD)/analyze.out || exit 1; done
	@! command -v cppcheck >/dev/null || { echo '== cppcheck'; cppcheck -q --std=c99 --language=c \
	    --enable=warning,performance,portability -DSOFTFEM_IMPLEMENTATION --error-exitcode=1 \
	    --suppress=missingIncludeSystem --suppress=pointerSize softfem.h; }

format: ## lay out examples, tests and benches by tests/.clang-format
	clang-format -i --style=file:tests/.clang-format \
	    $(wildcard examples/*.[ch] tests/*.[ch] bench/*.[ch])

coverage: ## lines of softfem.h that the tests reach
	rm -rf $(BUILD)/coverage
	$(MAKE) check BUILD=$(BUILD)/coverage OPENMP=0 CFLAGS='-O0 -g' INSTRUMENT=--coverage
	gcov -n $(BUILD)/coverage/softfem.gcda $(BUILD)/coverage/tests/*.gcda | grep -A1 "File 'softfem.h'"

clean: ## remove every product
	rm -rf $(BUILD)

# Each program writes to a file of its own, so that what several print at a time stays apart. That file is printed
# when the program ends, under its number: so many have ended.
check: $(TEST_PROGRAMS)
	@mkdir -p $(BUILD)/scratch; rm -f $(TEST_PROGRAMS:=.failed) $(BUILD)/tests/ended; from=$$(date +%s); \
	echo "$(words $(TEST_PROGRAMS)) test programs, $(JOBS) at a time"; \
	echo $(TEST_PROGRAMS) | tr ' ' '\n' | $(ENVIRONMENT) xargs -P $(JOBS) -n 1 sh -c \
	    'from=$$(date +%s); $$1 >$$1.log 2>&1 || echo $$1 >$$1.failed; echo >>$(BUILD)/tests/ended; \
	    echo "== $$(($$(wc -l <$(BUILD)/tests/ended))) of $(words $(TEST_PROGRAMS)): $$1," \
	        "$$(($$(date +%s) - from)) s" | cat - $$1.log' sh; \
	failed=$$(cat $(TEST_PROGRAMS:=.failed) 2>/dev/null); \
	if [ -n "$$failed" ]; then echo "FAILED:" $$failed; exit 1; fi; \
	echo "every test passed: $(words $(TEST_PROGRAMS)) programs in $$(($$(date +%s) - from)) s"

check-examples: $(EXAMPLE_PROGRAMS)
	@k=0; for x in $(EXAMPLES); do \
	    k=$$((k + 1)); out=$(BUILD)/out/$$x; mkdir -p $$out; arguments="--quick --out $$out"; \
	    if [ $$x = hello ]; then arguments=; fi; \
	    if $(BUILD)/examples/$$x $$arguments >$$out/log 2>&1; \
	    then echo "example $$k of $(words $(EXAMPLES)) runs: $$x"; else cat $$out/log; echo "FAILED: example $$x"; exit 1; fi; \
	done

$(BUILD)/softfem.o: softfem.h $(BUILD)/flags
	$(CC) $(FLAGS) -DSOFTFEM_IMPLEMENTATION -c -o $@ -x c softfem.h

$(BUILD)/examples/hello: examples/hello.c softfem.h $(BUILD)/flags
	@mkdir -p $(@D)
	$(CC) $(FLAGS) -o $@ $< $(LDFLAGS) -lm

$(BUILD)/examples/%: examples/%.c $(wildcard examples/*.h examples/scenes/*.h) softfem.h $(BUILD)/softfem.o
	@mkdir -p $(@D)
	$(CC) $(FLAGS) $(FLAGS_$*) -o $@ $< $(BUILD)/softfem.o $(LDFLAGS) -lm

$(BUILD)/tests/%: tests/%.c $(wildcard tests/*.h) softfem.h $(BUILD)/softfem.o $(BUILD)/cmocka
	@mkdir -p $(@D)
	$(CC) $(FLAGS) $(FLAGS_$*) $(if $(filter $*,$(INSIDE)),$(if $(filter file,$(origin CFLAGS)),-O1)) -pthread -o $@ $< \
	    $(BUILD)/softfem.o $(LDFLAGS) -lcmocka -lm

$(BUILD)/tests/test_stress: bench/stress.h tests/bodies.h

$(BUILD)/tests/test_scenes: $(wildcard examples/scenes/*.h) examples/web/portable_math.h

$(addprefix $(BUILD)/bench/,real integrators accuracy stress hash mesher): tests/bodies.h tests/blocks.h

$(BUILD)/bench/hash $(BUILD)/bench/scenes: $(wildcard examples/scenes/*.h)

$(BUILD)/bench/%: bench/%.c $(wildcard bench/*.h) softfem.h $(BUILD)/softfem.o
	@mkdir -p $(@D)
	$(CC) $(FLAGS) $(FLAGS_$*) -DSFEM_BENCH_FLAGS='"$(CC) $(FLAGS)"' -o $@ $< \
	    $(BUILD)/softfem.o $(LDFLAGS) -lm

# Other people's solvers, each only if a probe compiles: bench/solver.c sees SFEM_BENCH_CHOLMOD,
# SFEM_BENCH_METIS, SFEM_BENCH_CBLAS; and SFEM_BENCH_EIGEN if there is a bench/solver_eigen.cpp.
$(BUILD)/bench/solver: bench/solver.c $(wildcard bench/solver_*.cpp bench/*.h) softfem.h \
                       $(BUILD)/softfem.o
	@mkdir -p $(@D)
	@defines=; libraries=; missing=; objects=; link='$(CC)'; \
	probe() { printf "#include <$$1>\nint main(void){return 0;}\n" | \
	    $$2 -x $$3 - -o /dev/null $$4 >/dev/null 2>&1; }; \
	if probe suitesparse/cholmod.h '$(CC)' c -lcholmod; \
	then defines="$$defines -DSFEM_BENCH_CHOLMOD"; libraries="$$libraries -lcholmod"; \
	else missing="$$missing libsuitesparse-dev"; fi; \
	if probe metis.h '$(CC)' c -lmetis; \
	then defines="$$defines -DSFEM_BENCH_METIS"; libraries="$$libraries -lmetis"; \
	else missing="$$missing libmetis-dev"; fi; \
	if probe cblas.h '$(CC)' c -lopenblas; \
	then defines="$$defines -DSFEM_BENCH_CBLAS"; libraries="$$libraries -lopenblas"; \
	else missing="$$missing libopenblas-dev"; fi; \
	if [ -f bench/solver_eigen.cpp ]; then \
	    if probe Eigen/Dense '$(CXX) -I/usr/include/eigen3' c++; then \
	        defines="$$defines -DSFEM_BENCH_EIGEN"; link='$(CXX)'; \
	        objects="$$objects $@_eigen.o"; \
	        $(CXX) -I/usr/include/eigen3 -I. -O3 -march=native -DNDEBUG -c -o $@_eigen.o \
	            bench/solver_eigen.cpp || exit 1; \
	    else missing="$$missing libeigen3-dev"; fi; fi; \
	if [ -n "$$missing" ]; \
	then echo "left out; to compare with them too: apt-get install$$missing"; fi; \
	$(CC) $(FLAGS) $$defines -DSFEM_BENCH_FLAGS='"$(CC) $(FLAGS)"' -c -o $@.o $< && \
	$$link $(if $(filter 1,$(OPENMP)),-fopenmp) $(INSTRUMENT) -o $@ $@.o $$objects \
	    $(BUILD)/softfem.o $(LDFLAGS) $$libraries -lm

# bench/step.c holds the implementation itself, to time its parts.
$(BUILD)/bench/step: bench/step.c bench/real.h tests/bodies.h examples/support.h softfem.h $(BUILD)/flags
	@mkdir -p $(@D)
	@cholmod=; printf '#include <suitesparse/cholmod.h>\nint main(void){return 0;}\n' | \
	    $(CC) -x c - -o /dev/null -lcholmod >/dev/null 2>&1 && \
	    cholmod='-DSFEM_BENCH_CHOLMOD -lcholmod'; \
	$(CC) $(FLAGS) -DSFEM_BENCH_FLAGS='"$(CC) $(FLAGS)"' -o $@ $< $(LDFLAGS) $$cholmod -lm

$(BUILD)/bench/eigen: bench/eigen.c bench/bench.h softfem.h $(BUILD)/softfem.o
	@mkdir -p $(@D)
	@others=; if printf '#include <arpack/arpack.h>\n#include <suitesparse/cholmod.h>\nint main(void){return 0;}\n' | \
	    $(CC) -x c - -o /dev/null -larpack -lcholmod >/dev/null 2>&1; \
	then others='-DSFEM_BENCH_ARPACK'; libraries='-larpack -lcholmod'; \
	else echo 'left out; to compare: apt-get install libarpack2-dev libsuitesparse-dev'; fi; \
	$(CC) $(FLAGS) $$others -DSFEM_BENCH_FLAGS='"$(CC) $(FLAGS)"' -o $@ $< $(BUILD)/softfem.o \
	    $(LDFLAGS) $$libraries -lm

# Everything is built anew when the compiler or its flags change.
$(BUILD)/flags: force
	@mkdir -p $(BUILD)
	@echo '$(CC) $(FLAGS)' | cmp -s - $@ || echo '$(CC) $(FLAGS)' >$@

# cmocka: there, or installed, or the command to type.
$(BUILD)/cmocka:
	@mkdir -p $(BUILD)
	@probe() { printf '#include <stdarg.h>\n#include <stddef.h>\n#include <stdint.h>\n#include \
	<setjmp.h>\n#include <cmocka.h>\nint main(void){cmocka_set_test_filter("");return 0;}\n' | \
	    $(CC) $(CFLAGS) $(CPPFLAGS) -x c - -o /dev/null $(LDFLAGS) -lcmocka >/dev/null 2>&1; }; \
	probe && { touch $@; exit 0; }; \
	sudo=; [ "$$(id -u)" = 0 ] || sudo='sudo -n'; \
	if command -v apt-get >/dev/null && $$sudo true 2>/dev/null; then \
	    echo 'cmocka, which the tests use, is missing: installing libcmocka-dev'; \
	    $$sudo apt-get install -y -q libcmocka-dev >$@.log 2>&1 || \
	    { $$sudo apt-get update -q >$@.log 2>&1 && \
	      $$sudo apt-get install -y -q libcmocka-dev >>$@.log 2>&1; }; \
	fi; \
	probe && { touch $@; exit 0; }; \
	echo 'The tests use cmocka, which is not installed. Type this, then make test again:'; \
	echo '    sudo apt-get install libcmocka-dev'; exit 1

force:
.DELETE_ON_ERROR:
.SECONDARY:
.PHONY: $(shell sed -n 's/^\([a-z-]*\):.*/\1/p' Makefile)
