@members
    dbo_checkpoint checkpoints[$CHECKPOINTS];
    dbo_backlash_state gears;
    dbo_place turns[$GEARS];
    double memory[$TERMS];
    int $MARK;
@init
    for (int k = 0; k < $TERMS; k++) state->memory[k] = 0.0;
    state->$MARK = 0;
    state->gears.turns = state->turns;
    state->gears.checkpoints = $CHECKPOINT_NAME;
    state->gears.memory = $MEMORY_NAME;
    dbo_backlash_load(&op, &state->gears, $SPARE);
    state->gears.last = $LAST;
@reset
    state->$MARK = 1;
    dbo_backlash_settle(&op, &state->gears, $INSIDE, $SPARE, x);
@step
    state->gears.turns = state->turns;
    state->gears.checkpoints = $CHECKPOINT_NAME;
    state->gears.memory = $MEMORY_NAME;
    $STEP
