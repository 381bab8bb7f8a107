/* fuzz.c - the targets of fuzz.h under libFuzzer: `make fuzz`, or by hand
 *
 *     SFEM_FUZZ=body build/fuzz/fuzz -max_total_time=60 build/fuzz/body
 *
 * SFEM_FUZZ names the target. SFEM_FUZZ_SEEDS, if set, is a directory that gets the good inputs to start from; an input
 * that fails is left in a file, which the same command takes in place of the directory.
 */
#define SFEM_STATIC
#define SOFTFEM_IMPLEMENTATION
#include "fuzz.h"

int LLVMFuzzerInitialize(int *argc, char ***argv);
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static const fuzz_target *target;

static void write_seeds(const char *directory)
{
    static unsigned char seed[FUZZ_LARGEST];
    char path[1024];
    size_t size;
    int k;
    for (k = 0; (size = target->seed(k, seed)) > 0; ++k) {
        FILE *f;
        snprintf(path, sizeof path, "%s/seed%d", directory, k);
        f = fopen(path, "wb");
        if (!f || fwrite(seed, 1, size, f) != size || fclose(f)) {
            fprintf(stderr, "%s cannot be written\n", path);
            exit(2);
        }
    }
}

int LLVMFuzzerInitialize(int *argc, char ***argv)
{
    const char *name = getenv("SFEM_FUZZ"), *directory = getenv("SFEM_FUZZ_SEEDS");
    int k;
    (void)argc, (void)argv;
    for (k = 0; k < FUZZ_TARGETS; ++k)
        if (name && strcmp(name, fuzz_targets[k].name) == 0) target = fuzz_targets + k;
    if (!target) {
        fprintf(stderr, "SFEM_FUZZ has to name a target:");
        for (k = 0; k < FUZZ_TARGETS; ++k) fprintf(stderr, " %s", fuzz_targets[k].name);
        fprintf(stderr, "\n");
        exit(2);
    }
    if (directory) write_seeds(directory);
    return 0;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    target->run(data, size);
    return 0;
}
