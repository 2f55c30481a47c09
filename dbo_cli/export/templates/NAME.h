/* TITLE
 * ORIGIN
 * Call NAME_init once, then NAME_step once every sample. README.md says the rest. */
#ifndef GUARD_H
#define GUARD_H

#include "dbo_kernel.h"
/*+ kernel_headers */

#ifdef __cplusplus
extern "C" {
#endif

/*+ macros */

/* All that one sample leaves behind for the next; may be copied. */
typedef struct {
/*+ members */
    NUMBER output; /* the last one */
} NAME_state;

/* The start after the drive has been at or below its lower end: no gear is engaged, nothing remembered. */
void NAME_init(NAME_state *state);

/* The start of an actuator that was switched on and trimmed to this drive, and rests there;
 * as NAME_init where the drive is not a number. */
void NAME_reset(NAME_state *state, NUMBER drive);

/* One sample: MEANING. An input that is not a number is ignored:
 * the last output comes again. */
NUMBER NAME_step(NAME_state *state, NUMBER input);

#ifdef __cplusplus
}
#endif

#endif
