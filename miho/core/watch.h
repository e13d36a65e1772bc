/* A check for Ctrl-C in calls that may take long. */
#ifndef MIHO_WATCH_H
#define MIHO_WATCH_H

#define OPERATIONS_OF_WATCH 4e6 /* between two checks: milliseconds */

/* `stops` is called every few milliseconds, until it returns true. */
typedef struct {
    int (*stops)(void *state);
    void *state;
    double worked;
    int stopped;
} watch;

/* Count operations; returns whether to stop. Without a watch nothing stops. */
static inline int stops_after(double operations, watch *by) {
    if (!by) return 0;
    by->worked += operations;
    if (by->worked >= OPERATIONS_OF_WATCH && !by->stopped) {
        by->worked = 0.0;
        by->stopped = by->stops(by->state);
    }
    return by->stopped;
}
#endif
