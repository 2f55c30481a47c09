/* The kernel's names as this export has them: what is compiled of it bears the export's name, so that
 * exports of any arithmetic stand in one program. Read anew by each of the kernel's headers. */
/*+ names */
