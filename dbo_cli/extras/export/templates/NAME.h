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

/*? timed */
#define GUARD_SAMPLE_RATE_HZ RATE /* call the step so often */
/*: timed */
/*? ahead */
#define GUARD_READ_AHEAD_S   AHEAD /* give the input this much earlier */
/*: ahead */
/*? counts */
#define GUARD_IGNORED        (-2147483647 - 1) /* no number: the last output comes again */
/* INPUT_LABEL to counts, IGNORED beyond twice the range; and counts to OUTPUT_LABEL */
#define GUARD_IN(x) \
    (((x) - INPUT_MIDDLE) * INPUT_COUNTS > -2147483648.0 && ((x) - INPUT_MIDDLE) * INPUT_COUNTS < 2147483648.0 \
         ? (int32_t)(((x) - INPUT_MIDDLE) * INPUT_COUNTS) \
         : GUARD_IGNORED)
#define GUARD_OUT(q) ((q) * OUTPUT_COUNT + OUTPUT_MIDDLE)
/*: counts */

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
