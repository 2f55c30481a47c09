@members
    size_t ${NAME}_segment;
@init
    state->${NAME}_segment = 0;
