/* TITLE: a flat library. Handles are opaque pointers; every call gives 0, or -1 for a handle that is none.
 * For LabVIEW, MATLAB loadlibrary, Julia ccall and ctypes: plain types only. */
#ifndef GUARD_LIBRARY_H
#define GUARD_LIBRARY_H

#if defined(_WIN32)
#define GUARD_API __declspec(dllexport)
#elif defined(__GNUC__)
#define GUARD_API __attribute__((visibility("default")))
#else
#define GUARD_API
#endif

#ifdef __cplusplus
extern "C" {
#endif

/* A new actuator, in the state after a drive at its lower end; NULL where there is no memory. */
GUARD_API void *NAME_create(void);
GUARD_API int NAME_destroy(void *handle);

/* The start after a drive at its lower end, or trimmed to a drive and resting there. */
GUARD_API int NAME_start_empty(void *handle);
GUARD_API int NAME_start_settled(void *handle, double drive);

/* `count` samples at the fixed rate; output may be input. */
GUARD_API int NAME_run(void *handle, const double *input, double *output, int count);

/* Samples per second (0: time plays no part), and seconds to read the input ahead. */
GUARD_API double NAME_sample_rate(void);
GUARD_API double NAME_read_ahead(void);

#ifdef __cplusplus
}
#endif

#endif
