/* What the parts of the extension share: the limited ABI, and the functions that _kernel.c lists. */
#ifndef DBO_KERNEL_EXTENSION_H
#define DBO_KERNEL_EXTENSION_H

#define Py_LIMITED_API 0x030b0000
#define PY_SSIZE_T_CLEAN
#include <Python.h>

#define NUMBERS(view) ((size_t)(view).len / sizeof(double))

PyObject *between(PyObject *module, PyObject *args);      /* _smooth.c */
PyObject *between_even(PyObject *module, PyObject *args); /* _smooth.c */

#endif
