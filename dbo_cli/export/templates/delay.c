@members
    $NUMBER wanted[$WINDOW];
    int waiting;
@init
    state->waiting = 1;
@step
    for (int k = 0; k < $WINDOW; k++) /* at rest before the first sample */
        state->wanted[k] = state->waiting || k == $WINDOW - 1 ? x : state->wanted[k + 1];
    state->waiting = 0;
    x = $BETWEEN;
