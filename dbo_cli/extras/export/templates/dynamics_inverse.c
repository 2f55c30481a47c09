    if (!state->moving) { /* at rest at the first sample */
/*+ fill_windows */
        for (size_t k = 0; k < SECTIONS; k++) {
            state->sections[k].y = x;
            state->sections[k].a = state->sections[k].b = 0.0;
        }
        state->moving = 1;
    }
/*+ undo_sections */
