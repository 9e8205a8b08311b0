/* Runs the files that are named through a target, without libFuzzer: one line a file, so that the last one is the one
 * that broke something. */
#include "fuzz.h"

#define INPUT_MAX 65536

int main(int argc, char **argv)
{
	for (int i = 1; i < argc; ++i) {
		uint8_t *const bytes = malloc(INPUT_MAX);
		FILE *const file = fopen(argv[i], "rb");
		if (!bytes || !file)
			return 2;
		puts(argv[i]);
		fflush(stdout);
		const size_t size = fread(bytes, 1, INPUT_MAX, file);
		fclose(file);
		uint8_t *const exact = realloc(bytes, size ? size : 1);
		LLVMFuzzerTestOneInput(exact ? exact : bytes, size);
		free(exact ? exact : bytes);
	}
	return 0;
}
