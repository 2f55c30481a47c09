    if (!state->delay_filled) {
        for (uint32_t k = 0U; k < SLOTSU; k++) state->delayed[k] = x;
        state->delay_filled = 1;
    }
    state->delayed[state->delay_at] = x;
    {
/*? !counts */
        static const NUMBER times[DBO_WINDOW] = {ZERO, ONE, TWO, THREE, FOUR, FIVE};
/*: counts */
        NUMBER window[DBO_WINDOW];
        for (uint32_t k = 0U; k < DBO_WINDOW; k++)
            window[k] = state->delayed[(state->delay_at + 1U + k) % SLOTSU];
/*? counts */
        x = dbo_between(window, PLACE_IN_WINDOW, PART);
/*: counts */
/*? !counts */
        x = dbo_between(times, window, PLACE_IN_WINDOW, PART);
/*: counts */
    }
    state->delay_at = (state->delay_at + 1U) % SLOTSU;
