/* tau = M(q) a + C(q, dq) dq + G(q) + effects, a = ddq_d + 2 w (dq_d - dq) + w^2 (q_d - q). */
#include "controller.h"

#include <string.h>

void computed_torque(controller *c, const controller_reference *reference, const double *q,
    const double *dq, double *torque)
{
    const double w = c->settings.bandwidth;
    double friction[ARM_JOINTS];
    arm_sample sample;
    memset(&sample, 0, sizeof sample); /* this example measures no temperatures */
    for (int j = 0; j < ARM_JOINTS; j++)
        sample.ddq[j] = reference->ddq[j] + 2.0 * w * (reference->dq[j] - dq[j])
                        + w * w * (reference->q[j] - q[j]);
    arm_rigid_torque(q, dq, sample.ddq, torque);

    /* Friction at the reference: with measured velocities it would chatter at rest. */
    memcpy(sample.q, reference->q, sizeof sample.q);
    memcpy(sample.dq, reference->dq, sizeof sample.dq);
    sample.time = c->cycles * c->settings.period;
    arm_advance(&c->state, &sample, c->settings.smooth_velocity);
    arm_effect_torque(&sample, torque, &c->state, c->settings.smooth_velocity, friction);
    for (int j = 0; j < ARM_JOINTS; j++) torque[j] += friction[j];
}
