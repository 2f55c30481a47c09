/* See NAME_library.h. */
#include "NAME_library.h"
#include "NAME.h"

#include <stdlib.h>

void *NAME_create(void) {
    NAME_state *state = (NAME_state *)malloc(sizeof *state);
    if (state != NULL) NAME_init(state);
    return state;
}

int NAME_destroy(void *handle) {
    free(handle);
    return handle == NULL ? -1 : 0;
}

int NAME_start_empty(void *handle) {
    if (handle == NULL) return -1;
    NAME_init((NAME_state *)handle);
    return 0;
}

int NAME_start_settled(void *handle, double drive) {
    if (handle == NULL) return -1;
    NAME_reset((NAME_state *)handle, drive);
    return 0;
}

int NAME_run(void *handle, const double *input, double *output, int count) {
    if (handle == NULL || count < 0 || (count > 0 && (input == NULL || output == NULL))) return -1;
    for (int k = 0; k < count; k++) output[k] = NAME_step((NAME_state *)handle, input[k]);
    return 0;
}

double NAME_sample_rate(void) { return RATE; }
double NAME_read_ahead(void) { return AHEAD; }
