/* What pinocchio_calls.cpp needs of an export besides its functions of plain arrays. */
#include <string.h>

#include "arm.h"

const int arm_joints = ARM_JOINTS;

void arm_acceleration(const REAL *q, const REAL *dq, const REAL *torque, REAL *acceleration)
{
    static arm_sample sample;
    static arm_state state;
    memcpy(sample.q, q, sizeof sample.q);
    memcpy(sample.dq, dq, sizeof sample.dq);
    arm_forward_dynamics(&sample, torque, &state, NULL, acceleration);
}
