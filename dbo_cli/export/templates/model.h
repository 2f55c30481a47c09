/* $TITLE
 * $ORIGIN
 * Call ${NAME}_init once, then ${NAME}_step once every sample. README.md says the rest. */
#ifndef ${GUARD}_H
#define ${GUARD}_H

$INCLUDES
#ifdef __cplusplus
extern "C" {
#endif

#define ${GUARD}_SAMPLE_RATE_HZ $RATE /* call the step so often */
#define ${GUARD}_AHEAD $AHEAD /* samples: give the input so much earlier */
$COUNTS

/* All that one sample leaves behind for the next; may be copied. */
typedef struct {
$MEMBERS
    $NUMBER output; /* the last one */
} ${NAME}_state;

/* The start after the drive has been at or below its lower end for a while: no gear is engaged, and it rests. */
void ${NAME}_init(${NAME}_state *state);

/* The start of an actuator that was switched on and trimmed to this drive, and rests there;
 * as ${NAME}_init where the drive is not a number. */
void ${NAME}_reset(${NAME}_state *state, $NUMBER drive);

/* One sample: the displacement wanted in, the drive out. An input that is not a number is ignored:
 * the last output comes again. */
$NUMBER ${NAME}_step(${NAME}_state *state, $NUMBER input);

#ifdef __cplusplus
}
#endif

#endif
