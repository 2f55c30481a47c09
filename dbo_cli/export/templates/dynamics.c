@members
    dbo_inverse_state sections[$SECTIONS];
    int moving;
@init
    state->moving = 0;
@step
    state->moving = 1;
