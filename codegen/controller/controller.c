#define _POSIX_C_SOURCE 199309L /* clock_gettime */
#include "controller.h"

#include <string.h>
#include <time.h>

int controller_size(void) { return (int)sizeof(controller); }

void controller_begin(controller *c, const controller_settings *settings, const double *q)
{
    double inertia[ARM_JOINTS * ARM_JOINTS];
    memset(c, 0, sizeof *c);
    c->settings = *settings;
    arm_begin(&c->state);
    memcpy(c->q_before, q, sizeof c->q_before);
    arm_mass_matrix(q, inertia);
    for (int j = 0; j < ARM_JOINTS; j++)
        c->damping[j] = settings->bandwidth * inertia[j * ARM_JOINTS + j];
    memcpy(c->parameters, arm_link_parameters, sizeof arm_link_parameters);
#if ARM_EFFECT_COEFFICIENTS > 0
    memcpy(c->parameters + ARM_LINK_PARAMETERS, arm_effect_coefficients,
        sizeof arm_effect_coefficients);
#endif
}

static double seconds(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

double controller_cycle(controller *c, const controller_reference *reference, const double *q,
    double *torque)
{
    double dq[ARM_JOINTS];
    const double start = seconds();
    for (int j = 0; j < ARM_JOINTS; j++) {
        dq[j] = (q[j] - c->q_before[j]) / c->settings.period;
        c->q_before[j] = q[j];
    }
    if (c->settings.law == SLOTINE_LI)
        slotine_li(c, reference, q, dq, torque);
    else
        computed_torque(c, reference, q, dq, torque);
    c->cycles += 1.0;
    return seconds() - start;
}
