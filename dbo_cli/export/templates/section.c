@members
    double window_${PLACE}[$WINDOW];
@step
    if (!state->moving) { /* at rest before the first sample */
        for (size_t k = 0; k <= $AHEAD; k++) state->window_${PLACE}[k] = x;
        state->sections[${PLACE}].y = x;
        state->sections[${PLACE}].a = state->sections[${PLACE}].b = 0.0;
    }
    for (size_t k = 1; k <= $AHEAD; k++) state->window_${PLACE}[k - 1] = state->window_${PLACE}[k];
    state->window_${PLACE}[$AHEAD] = x;
    dbo_dynamics_undo(&sections[${PLACE}], &state->sections[${PLACE}], state->window_${PLACE}, &x, 1);
