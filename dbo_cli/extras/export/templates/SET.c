/* TITLE
 * ORIGIN */
#include "NAME.h"

void NAME_init(NAME_state *state) {
/*+ inits */
}

void NAME_reset(NAME_state *state, const NUMBER *drives) {
/*+ resets */
}

void NAME_step(NAME_state *state, const NUMBER *in, NUMBER *out) {
/*+ steps */
}
