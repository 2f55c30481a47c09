/* TITLE
 * ORIGIN
 * Call NAME_init once, then NAME_step once every sample. README.md says the rest. */
#ifndef GUARD_H
#define GUARD_H

/*+ headers */

#ifdef __cplusplus
extern "C" {
#endif

#define GUARD_CHANNELS COUNT /* numbers in each array, in the order of the state's members */

/* All that one sample of all channels leaves behind for the next; may be copied. */
typedef struct {
/*+ states */
} NAME_state;

/* NAME_CHANNEL_init of each. */
void NAME_init(NAME_state *state);

/* NAME_CHANNEL_reset of each, to its drive. */
void NAME_reset(NAME_state *state, const NUMBER *drives);

/* One sample of all: NAME_CHANNEL_step of each; both arrays may be the same. */
void NAME_step(NAME_state *state, const NUMBER *in, NUMBER *out);

#ifdef __cplusplus
}
#endif

#endif
