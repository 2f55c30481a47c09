/*? ahead */
    for (size_t k = 0; k < AHEAD; k++) state->WINDOW[k] = state->WINDOW[k + 1];
/*: ahead */
    state->WINDOW[AHEAD] = x;
    dbo_dynamics_undo(&sections[PLACE], &state->sections[PLACE], state->WINDOW, &x, 1);
