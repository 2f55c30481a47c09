    if (!state->delay_filled) {
        for (uint32_t k = 0U; k < SLOTSU; k++) state->delayed[k] = x;
        state->delay_filled = 1;
    }
    state->delayed[state->delay_at] = x;
    {
        const NUMBER later = state->delayed[(state->delay_at + LATERU) % SLOTSU];
        const NUMBER earlier = state->delayed[(state->delay_at + EARLIERU) % SLOTSU];
        (void)earlier;
        x = BETWEEN;
    }
    state->delay_at = (state->delay_at + 1U) % SLOTSU;
