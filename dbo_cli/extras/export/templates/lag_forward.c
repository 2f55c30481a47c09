    if (!state->lagging) { /* at rest at the first sample */
        state->lag.p = state->lag.u = x;
        state->lag.q = 0.0;
        state->lagging = 1;
    }
    dbo_dynamics_run(1, &lag_output, &state->lag, &x, &x, 1, lag_step, 0);
/*+ once */
