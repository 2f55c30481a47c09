    if (!state->moving) { /* at rest at the first sample */
        for (size_t k = 0; k < SECTIONS; k++) {
            state->sections[k].p = state->sections[k].u = x;
            state->sections[k].q = 0.0;
        }
        state->moving = 1;
    }
    dbo_dynamics_run(SECTIONS, section_outputs, state->sections, &x, &x, 1, section_steps, 0);
