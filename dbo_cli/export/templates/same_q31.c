/* So many samples may come after a turn on a gear's end. Of 276 random models one left the first bound in 48 % of the
 * samples of a move, the others in 7 % at most. */
#define MAY_DIFFER ($COUNT / 2U)

/* In counts; after a turn on a gear's end the wider bound holds. */
static unsigned difference(int32_t got, int32_t expected) {
    const int64_t way = (int64_t)got - expected, apart = way < 0 ? -way : way;
    if (apart <= $SAME_COUNTS) return 0U;
    return apart <= $CLOSE_COUNTS ? 1U : ${COUNT}U;
}
