// One call after the other of exported C and of Pinocchio in C++, in turns: nanoseconds per call.
// REAL is double or float. Argument: a file with the numbers of the arm, see against_pinocchio.py.
#include <pinocchio/algorithm/aba.hpp>
#include <pinocchio/algorithm/crba.hpp>
#include <pinocchio/algorithm/frames.hpp>
#include <pinocchio/algorithm/jacobian.hpp>
#include <pinocchio/algorithm/kinematics.hpp>
#include <pinocchio/algorithm/regressor.hpp>
#include <pinocchio/algorithm/rnea.hpp>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <ctime>
#include <fstream>
#include <functional>
#include <random>
#include <string>
#include <vector>

namespace pin = pinocchio;

extern "C" { // the export, and arm_calls.c
extern const int arm_joints;
void arm_rigid_torque(const REAL *q, const REAL *dq, const REAL *ddq, REAL *torque);
void arm_gravity(const REAL *q, REAL *torque);
void arm_mass_matrix(const REAL *q, REAL *matrix);
void arm_coriolis(const REAL *q, const REAL *dq, REAL *matrix);
void arm_forward_kinematics(const REAL *q, REAL *pose);
void arm_jacobian(const REAL *q, REAL *matrix);
void arm_regressor(const REAL *q, const REAL *dq, const REAL *ddq, REAL *matrix);
void arm_acceleration(const REAL *q, const REAL *dq, const REAL *torque, REAL *acceleration);
}

constexpr int samples = 256, rounds = 41, repeats = 8;
using Vector = Eigen::Matrix<REAL, Eigen::Dynamic, 1>;
using Ref = Eigen::Ref<const Vector>; // for which the library has these algorithms
using RowMajor = Eigen::Matrix<REAL, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

struct Motion {
    Vector q, dq, ddq, tau;
};

static double processor_seconds()
{
    timespec now;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
    return double(now.tv_sec) + 1e-9 * double(now.tv_nsec);
}

struct Pair {
    std::string name;
    std::function<void(const Motion &)> ours, theirs;
    std::function<double()> difference; // of the results of the last calls, relative
};

template <class Call> static double nanoseconds(const std::vector<Motion> &motions, const Call &call)
{
    const double start = processor_seconds();
    for (int r = 0; r < repeats; r++)
        for (const Motion &m : motions) call(m);
    return 1e9 * (processor_seconds() - start) / (repeats * samples);
}

static double median(std::vector<double> values)
{
    std::nth_element(values.begin(), values.begin() + values.size() / 2, values.end());
    return values[values.size() / 2];
}

static pin::SE3 pose_from(std::istream &file)
{
    Eigen::Matrix4d matrix;
    for (int i = 0; i < 4; i++)
        for (int j = 0; j < 4; j++) file >> matrix(i, j);
    return pin::SE3(matrix);
}

// The joints as a URDF reader makes them: an axis along z has a type of its own.
static pin::Model model_from(const char *path)
{
    std::ifstream file(path);
    pin::Model model;
    file >> model.gravity.linear()[0] >> model.gravity.linear()[1] >> model.gravity.linear()[2];
    int n = 0;
    file >> n;
    for (int j = 0; j < n; j++) {
        const pin::SE3 placement = pose_from(file);
        Eigen::Vector3d axis;
        Eigen::Matrix<double, 10, 1> link;
        for (double &x : axis) file >> x;
        for (double &x : link) file >> x;
        pin::JointModel joint = pin::JointModelRevoluteUnaligned(axis);
        if (axis.isApprox(Eigen::Vector3d::UnitX())) joint = pin::JointModelRX();
        if (axis.isApprox(Eigen::Vector3d::UnitY())) joint = pin::JointModelRY();
        if (axis.isApprox(Eigen::Vector3d::UnitZ())) joint = pin::JointModelRZ();
        model.addJoint(model.njoints - 1, joint, placement, "joint" + std::to_string(j));
        model.appendBodyToJoint(model.njoints - 1, pin::Inertia::FromDynamicParameters(link));
    }
    model.addFrame(pin::Frame("tool", model.njoints - 1, pose_from(file), pin::OP_FRAME));
    return model;
}

int main(int, char **argv)
{
    using Model = pin::ModelTpl<REAL>;
    using Data = pin::DataTpl<REAL>;
    const Model model = model_from(argv[1]).cast<REAL>();
    Data data(model);
    const int n = model.nv;
    const pin::FrameIndex tool = model.getFrameId("tool");
    if (n != arm_joints) return 1;

    std::mt19937 random(1);
    std::uniform_real_distribution<REAL> one(-1, 1);
    auto vector = [&] { return Vector(Vector::NullaryExpr(n, [&](auto) { return one(random); })); };
    std::vector<Motion> motions;
    for (int k = 0; k < samples; k++) {
        Motion m{vector(), vector(), vector(), Vector(n)};
        m.tau = pin::rnea(model, data, m.q, m.dq, m.ddq);
        motions.push_back(m);
    }

    Vector torque(n), gravity(n), acceleration(n);
    RowMajor mass(n, n), coriolis(n, n), regressor(n, 10 * n), jacobian(6, n), pose(4, 4);
    Data::Matrix6x frame(6, n);
    auto relative = [](const auto &a, const auto &b) {
        return double((a - b).cwiseAbs().maxCoeff() / b.cwiseAbs().maxCoeff());
    };
    RowMajor symmetric;
    const std::vector<Pair> pairs{
        {"torque",
         [&](const Motion &m) { arm_rigid_torque(m.q.data(), m.dq.data(), m.ddq.data(), torque.data()); },
         [&](const Motion &m) { pin::rnea(model, data, m.q, m.dq, m.ddq); },
         [&] { return relative(torque, data.tau); }},
        {"mass matrix", [&](const Motion &m) { arm_mass_matrix(m.q.data(), mass.data()); },
         [&](const Motion &m) { pin::crba(model, data, Ref(m.q), pin::Convention::WORLD); },
         [&] {
             symmetric = data.M.selfadjointView<Eigen::Upper>();
             return relative(mass, symmetric);
         }},
        {"gravity", [&](const Motion &m) { arm_gravity(m.q.data(), gravity.data()); },
         [&](const Motion &m) { pin::computeGeneralizedGravity(model, data, m.q); },
         [&] { return relative(gravity, data.g); }},
        {"regressor",
         [&](const Motion &m) { arm_regressor(m.q.data(), m.dq.data(), m.ddq.data(), regressor.data()); },
         [&](const Motion &m) { pin::computeJointTorqueRegressor(model, data, m.q, m.dq, m.ddq); },
         [&] { return relative(regressor, data.jointTorqueRegressor); }},
        {"forward dynamics",
         [&](const Motion &m) {
             arm_acceleration(m.q.data(), m.dq.data(), m.tau.data(), acceleration.data());
         },
         [&](const Motion &m) { pin::aba(model, data, Ref(m.q), Ref(m.dq), Ref(m.tau), pin::Convention::WORLD); },
         [&] { return relative(acceleration, data.ddq); }},
        {"Coriolis matrix",
         [&](const Motion &m) { arm_coriolis(m.q.data(), m.dq.data(), coriolis.data()); },
         [&](const Motion &m) { pin::computeCoriolisMatrix(model, data, m.q, m.dq); },
         [&] { return relative(coriolis, data.C); }},
        {"pose of the tool",
         [&](const Motion &m) { arm_forward_kinematics(m.q.data(), pose.data()); },
         [&](const Motion &m) {
             pin::forwardKinematics(model, data, m.q);
             pin::updateFramePlacement(model, data, tool);
         },
         [&] { return relative(pose, data.oMf[tool].toHomogeneousMatrix()); }},
        {"Jacobian of the tool", [&](const Motion &m) { arm_jacobian(m.q.data(), jacobian.data()); },
         [&](const Motion &m) {
             frame.setZero();
             pin::computeJointJacobians(model, data, m.q);
             pin::getFrameJacobian(model, data, tool, pin::LOCAL_WORLD_ALIGNED, frame);
         },
         [&] {
             RowMajor turned(6, n);
             turned << frame.bottomRows(3), frame.topRows(3);
             return relative(jacobian, turned);
         }},
    };
    for (const Pair &pair : pairs) {
        std::vector<double> ours, theirs;
        for (int r = 0; r < rounds; r++) {
            ours.push_back(nanoseconds(motions, pair.ours));
            theirs.push_back(nanoseconds(motions, pair.theirs));
        }
        std::printf("%s\t%.1f\t%.1f\t%.1e\n", pair.name.c_str(), median(ours), median(theirs),
                    pair.difference());
    }
    return 0;
}
