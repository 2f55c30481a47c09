/* The kernel's names, made this export's own: exports of any arithmetic stand side by side in one program.
 * Each of the kernel's headers reads this again, since another export may have been included between. */
#undef DBO_FLOAT
#undef DBO_Q31
#undef DBO_PLACE
#undef DBO_SPACING
#define DBO_PLACE PLACE
#define DBO_SPACING SPACING
/*? float */
#define DBO_FLOAT
/*: float */
/*? q31 */
#define DBO_Q31
/*: q31 */
/*+ names */
