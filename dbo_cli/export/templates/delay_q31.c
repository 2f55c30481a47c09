@members
    int32_t wanted[6];
    int waiting;
@init
    state->waiting = 1;
@step
    for (int k = 0; k < DBOQ_WINDOW; k++) /* at rest before the first sample */
        state->wanted[k] = state->waiting || k == DBOQ_WINDOW - 1 ? x : state->wanted[k + 1];
    state->waiting = 0;
    x = dboq_between(state->wanted, 2, $PART);
