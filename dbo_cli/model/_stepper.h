/* One operator, its limits and its state, held from one live sample to the next: see PythonStepper. */
#ifndef DBO_STEPPER_H
#define DBO_STEPPER_H

#include <Python.h>

#include "dbo_kernel.h"

typedef struct {
    PyObject_HEAD
    Py_buffer gears;
    Py_buffer guide;
    dbo_backlash op;
    dbo_limits limits;
    double largest_change;
    int limited;
    double *decay;
    dbo_fixed_step fixed;
    void *table; /* of `fixed`; NULL where it gives nothing */
    dbo_backlash_state now;
    dbo_backlash_state next;
    int planned;
    size_t clipped;
    double *memory;   /* of both, then gains and decay */
} stepper;

extern PyType_Spec bank_spec;

int is_stepper(PyObject *object);

/* The output for an input, and the state to go to. */
double stepper_step(stepper *self, double x);

/* The state to go to, where the output was `y`. */
void stepper_follow(stepper *self, double y);

#endif
