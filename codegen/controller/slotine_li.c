/* Adaptive control: Slotine, Li, "On the adaptive control of robot manipulators", IJRR 1987.
 *
 *   s = dq - dq_r,  dq_r = dq_d - w (q - q_d)
 *   tau = Y(q, dq, dq_r, ddq_r) p - K s,  dp/dt = -gain * sizes^2 * Y' s
 *
 * Y holds the links' columns and those of the effects, the latter at dq_r and ddq_r.
 */
#include "controller.h"

#include <string.h>

enum { LINKS = ARM_LINK_PARAMETERS, EFFECTS = ARM_EFFECT_COEFFICIENTS };

/* y += matrix * x */
static void add_product(const double *matrix, int columns, const double *x, double *y)
{
    for (int i = 0; i < ARM_JOINTS; i++)
        for (int k = 0; k < columns; k++) y[i] += matrix[i * columns + k] * x[k];
}

/* Euler step of the parameters of some columns */
static void adapt(const controller *c, const double *matrix, int columns, const double *s,
    int first, double *parameters)
{
    for (int k = 0; k < columns; k++) {
        const double size = c->settings.sizes[first + k];
        double gradient = 0.0;
        for (int i = 0; i < ARM_JOINTS; i++) gradient += matrix[i * columns + k] * s[i];
        parameters[first + k] -= c->settings.period * c->settings.adaptation * size * size * gradient;
    }
}

void slotine_li(controller *c, const controller_reference *reference, const double *q,
    const double *dq, double *torque)
{
    const double w = c->settings.bandwidth;
    double y[ARM_JOINTS * LINKS], s[ARM_JOINTS];
    arm_sample sample; /* with the reference velocity and acceleration of the law */
    memset(&sample, 0, sizeof sample);
    for (int j = 0; j < ARM_JOINTS; j++) {
        sample.q[j] = q[j];
        sample.dq[j] = reference->dq[j] - w * (q[j] - reference->q[j]);
        sample.ddq[j] = reference->ddq[j] - w * (dq[j] - reference->dq[j]);
        s[j] = dq[j] - sample.dq[j];
        torque[j] = 0.0;
    }
    sample.time = c->cycles * c->settings.period;
    arm_slotine_li_regressor(q, dq, sample.dq, sample.ddq, y);
    add_product(y, LINKS, c->parameters, torque);
    arm_advance(&c->state, &sample, c->settings.smooth_velocity);
#if ARM_EFFECT_COEFFICIENTS > 0
    double columns[ARM_JOINTS * EFFECTS], load[ARM_JOINTS];
    memcpy(load, torque, sizeof load);
    arm_effect_columns(&sample, load, &c->state, c->settings.smooth_velocity, columns);
    add_product(columns, EFFECTS, c->parameters + LINKS, torque);
    adapt(c, columns, EFFECTS, s, LINKS, c->parameters);
#endif
    adapt(c, y, LINKS, s, 0, c->parameters);
    for (int j = 0; j < ARM_JOINTS; j++) torque[j] -= c->damping[j] * s[j];
}
