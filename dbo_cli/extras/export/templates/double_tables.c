/*+ gear_rows */
/*+ term_tables */
/*? terms */
static const dbo_backlash op = {gears, GEARS, RUN, DBO_ROW_FACTOR(RUN), 0, 0, 0.0,
    X_START, Y_START, 1, TERMS, gain, REFERENCE, ON_OUTPUT};
/*: terms */
/*? !terms */
static const dbo_backlash op = {gears, GEARS, RUN, DBO_ROW_FACTOR(RUN), 0, 0, 0.0,
    X_START, Y_START, 1, TERMS, 0, REFERENCE, ON_OUTPUT};
/*: terms */
/*? fixed */
/*+ fixed_rows */
/*+ rest_table */
/*? terms */
static const dbo_fixed_step fixed = {KAPPA, decay, rest, fixed_gears, 0, 0.0};
/*: terms */
/*? !terms */
static const dbo_fixed_step fixed = {KAPPA, 0, 0, fixed_gears, 0, 0.0};
/*: terms */
/*: fixed */
/*? lookup */
/*+ corner_tables */
static const dbo_lookup lookup = {&op, &fixed, corners, lowest};
/*: lookup */
/*+ spare_table */
/*? constant_limits */
/*? slew */
static const double largest_change = CHANGE;
static const dbo_limits limits = {LEAST, MOST, SLACK, &largest_change, 0};
/*: slew */
/*? !slew */
static const dbo_limits limits = {LEAST, MOST, SLACK, 0, 0};
/*: slew */
/*: constant_limits */
