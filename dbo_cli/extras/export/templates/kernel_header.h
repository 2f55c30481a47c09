/* One of the kernel's headers as it is, its names made this export's own. */
#ifndef OWN_GUARD
#define OWN_GUARD
#include "NAME_names.h"
#undef KERNEL_GUARD
/*+ text */
#endif
