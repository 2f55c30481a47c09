#define ${GUARD}_IGNORED (-2147483647 - 1) /* no number: the last output comes again */
/* $INPUT to counts, IGNORED beyond twice the range; and counts to $OUTPUT */
#define ${GUARD}_SCALED(x) (((x) - $IN_MIDDLE) * $IN_SCALE)
#define ${GUARD}_IN(x) \
    (${GUARD}_SCALED(x) > -2147483648.0 && ${GUARD}_SCALED(x) < 2147483648.0 ? (int32_t)${GUARD}_SCALED(x) : ${GUARD}_IGNORED)
#define ${GUARD}_OUT(q) ((q) * $OUT_SCALE + $OUT_MIDDLE)
