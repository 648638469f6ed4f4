// Crocoddyl on the problem of benchmarks/vs_crocoddyl.py: a quadruped that stands on four feet.
//
// usage: standing PROBLEM, a file that problem_file.py writes. One command a line on the standard input, one line of JSON
// for each on the standard output:
//   physics      cost, next states and their derivatives at the iterate of PROBLEM
//   steps N      the step sizes of a solve of N iterations
//   time R N     µs per node of each part of an iteration (the least of R calls) and of an iteration of a solve of N

#include <time.h>

#include <algorithm>
#include <fstream>
#include <functional>
#include <iomanip>
#include <iostream>
#include <limits>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

#include <Eigen/Core>

#include "crocoddyl/core/activations/weighted-quadratic.hpp"
#include "crocoddyl/core/costs/cost-sum.hpp"
#include "crocoddyl/core/costs/residual.hpp"
#include "crocoddyl/core/integrator/euler.hpp"
#include "crocoddyl/core/optctrl/shooting.hpp"
#include "crocoddyl/core/residuals/control.hpp"
#include "crocoddyl/core/solvers/fddp.hpp"
#include "crocoddyl/multibody/actions/contact-fwddyn.hpp"
#include "crocoddyl/multibody/actuations/floating-base.hpp"
#include "crocoddyl/multibody/contacts/contact-3d.hpp"
#include "crocoddyl/multibody/contacts/multiple-contacts.hpp"
#include "crocoddyl/multibody/residuals/state.hpp"
#include "crocoddyl/multibody/states/multibody.hpp"

using Eigen::VectorXd;
using std::make_shared;
using std::shared_ptr;
using Path = std::vector<VectorXd>;

struct Problem {
  shared_ptr<pinocchio::Model> model = make_shared<pinocchio::Model>();
  std::vector<std::string> feet;  // names of frames
  std::size_t nodes, nx, nu;
  double dt, gamma, position, velocity, torque;
  VectorXd initial;
  Path targets, x, u;
};

static pinocchio::SE3 read_placement(std::istream& from) {
  pinocchio::SE3 placement;
  for (int i = 0; i < 9; i++) from >> placement.rotation()(i / 3, i % 3);
  for (auto& number : placement.translation()) from >> number;
  return placement;
}

static pinocchio::Inertia read_inertia(std::istream& from) {
  double mass = 0;
  Eigen::Vector3d lever;
  Eigen::Matrix3d inertia;
  from >> mass;
  for (auto& number : lever) from >> number;
  for (int i = 0; i < 9; i++) from >> inertia(i / 3, i % 3);
  return pinocchio::Inertia(mass, lever, inertia);
}

static pinocchio::JointModel joint_of(const std::string& kind) {
  if (kind == "JointModelFreeFlyer") return pinocchio::JointModelFreeFlyer();
  if (kind == "JointModelRX") return pinocchio::JointModelRX();
  if (kind == "JointModelRY") return pinocchio::JointModelRY();
  if (kind == "JointModelRZ") return pinocchio::JointModelRZ();
  throw std::runtime_error("joints of this kind are not known: " + kind);
}

// Joints, then frames, each with the number of the joint that carries it; number 0 is the world.
static void read_model(std::istream& from, pinocchio::Model& model) {
  std::size_t joints = 0, frames = 0, parent = 0;
  std::string name, kind;
  from >> joints;
  for (std::size_t i = 1; i <= joints; i++) {
    from >> name >> kind >> parent;
    const auto placement = read_placement(from);
    model.appendBodyToJoint(model.addJoint(parent, joint_of(kind), placement, name), read_inertia(from));
  }
  from >> frames;
  for (std::size_t i = 0; i < frames; i++) {
    from >> name >> parent;
    const auto placement = read_placement(from);
    model.addFrame(pinocchio::Frame(name, parent, placement, pinocchio::OP_FRAME));
  }
}

static Path read_rows(std::istream& from, std::size_t rows, std::size_t size) {
  Path path(rows, VectorXd(size));
  for (auto& row : path)
    for (auto& number : row) from >> number;
  return path;
}

static Problem read_problem(const std::string& name) {
  std::ifstream from(name);
  Problem p;
  std::size_t feet = 0;
  read_model(from, *p.model);
  from >> feet;
  p.feet.resize(feet);
  for (auto& foot : p.feet) from >> foot;
  from >> p.nodes >> p.nx >> p.nu >> p.dt >> p.gamma >> p.position >> p.velocity >> p.torque;
  p.initial = read_rows(from, 1, p.nx)[0];
  p.targets = read_rows(from, p.nodes, p.nx);
  p.x = read_rows(from, p.nodes + 1, p.nx);
  p.u = read_rows(from, p.nodes, p.nu);
  if (!from) throw std::runtime_error(name + ": not a problem's numbers");
  return p;
}

static shared_ptr<crocoddyl::ShootingProblem> shooting_problem(const Problem& p) {
  namespace c = crocoddyl;
  const auto state = make_shared<c::StateMultibody>(p.model);
  const auto actuation = make_shared<c::ActuationModelFloatingBase>(state);
  const auto nu = actuation->get_nu();
  const auto contacts = make_shared<c::ContactModelMultiple>(state, nu);
  for (const auto& foot : p.feet)
    contacts->addContact(foot, make_shared<c::ContactModel3D>(
                                   state, p.model->getFrameId(foot), Eigen::Vector3d::Zero(),
                                   pinocchio::LOCAL_WORLD_ALIGNED, nu, Eigen::Vector2d(0.0, p.gamma)));
  VectorXd weights(state->get_ndx());
  weights << VectorXd::Constant(state->get_nv(), p.position), VectorXd::Constant(state->get_nv(), p.velocity);
  const auto activation = make_shared<c::ActivationModelWeightedQuad>(weights);
  const auto action = [&](shared_ptr<c::CostModelSum> costs, double dt) -> shared_ptr<c::ActionModelAbstract> {
    // no damping; without derivatives of the forces, which no cost here needs
    const auto dynamics =
        make_shared<c::DifferentialActionModelContactFwdDynamics>(state, actuation, contacts, costs, 0.0, false);
    return make_shared<c::IntegratedActionModelEuler>(dynamics, dt);
  };
  std::vector<shared_ptr<c::ActionModelAbstract>> nodes;
  for (const auto& target : p.targets) {
    const auto costs = make_shared<c::CostModelSum>(state, nu);
    const auto tracked = make_shared<c::ResidualModelState>(state, target, nu);
    costs->addCost("state", make_shared<c::CostModelResidual>(state, activation, tracked), 1.0);
    const auto effort = make_shared<c::ResidualModelControl>(state, nu);
    costs->addCost("torque", make_shared<c::CostModelResidual>(state, effort), p.torque);
    nodes.push_back(action(costs, p.dt));
  }
  const auto end = action(make_shared<c::CostModelSum>(state, nu), 0.0);
  const auto problem = make_shared<c::ShootingProblem>(p.initial, nodes, end);
#ifdef CROCODDYL_WITH_MULTITHREADING  // a build without threads warns if it is told to use one
  problem->set_nthreads(1);
#endif
  return problem;
}

static double seconds_of_this_thread() {
  timespec t;
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
  return static_cast<double>(t.tv_sec) + 1e-9 * static_cast<double>(t.tv_nsec);
}

static double least(int calls, const std::function<void()>& part) {
  double shortest = std::numeric_limits<double>::infinity();
  for (int i = 0; i < calls; i++) {
    const double began = seconds_of_this_thread();
    part();
    shortest = std::min(shortest, seconds_of_this_thread() - began);
  }
  return shortest;
}

class Steps : public crocoddyl::CallbackAbstract {
 public:
  std::vector<double> sizes;
  void operator()(crocoddyl::SolverAbstract& solver) override { sizes.push_back(solver.get_steplength()); }
};

template <class Numbers>
static void write(const char* name, const Numbers& numbers) {
  std::cout << '"' << name << "\": [";
  for (std::size_t i = 0; i < static_cast<std::size_t>(numbers.size()); i++) std::cout << (i ? ", " : "") << numbers[i];
  std::cout << ']';
}

static void write_physics(crocoddyl::ShootingProblem& problem, const Problem& p) {
  std::cout << "{\"cost\": " << problem.calc(p.x, p.u);
  problem.calcDiff(p.x, p.u);
  std::vector<double> next, by_x, by_u;  // derivatives row by row
  for (const auto& data : problem.get_runningDatas()) {
    next.insert(next.end(), data->xnext.data(), data->xnext.data() + data->xnext.size());
    for (Eigen::Index r = 0; r < data->Fx.rows(); r++) {
      for (Eigen::Index c = 0; c < data->Fx.cols(); c++) by_x.push_back(data->Fx(r, c));
      for (Eigen::Index c = 0; c < data->Fu.cols(); c++) by_u.push_back(data->Fu(r, c));
    }
  }
  std::cout << ", ", write("xnext", next);
  std::cout << ", ", write("Fx", by_x);
  std::cout << ", ", write("Fu", by_u);
  std::cout << "}" << std::endl;
}

static void write_steps(crocoddyl::SolverFDDP& solver, const Problem& p, std::size_t iterations) {
  const auto steps = make_shared<Steps>();
  solver.setCallbacks({steps});
  solver.solve(p.x, p.u, iterations, false, 0.0);
  solver.setCallbacks({});
  std::cout << "{", write("steps", steps->sizes);
  std::cout << "}" << std::endl;
}

static void write_times(crocoddyl::SolverFDDP& solver, crocoddyl::SolverFDDP& at_guess, const Problem& p, int calls,
                        std::size_t iterations) {
  auto& problem = *at_guess.get_problem();
  const double scale = 1e6 / static_cast<double>(p.nodes);
  const double calc = scale * least(calls, [&] { problem.calc(p.x, p.u); });
  const double calc_diff = scale * least(calls, [&] { problem.calcDiff(p.x, p.u); });
  const double backward = scale * least(calls, [&] { at_guess.backwardPass(); });
  const double forward = scale * least(calls, [&] { at_guess.forwardPass(1.0); });
  const auto solve = [&](std::size_t n) { return [&, n] { solver.solve(p.x, p.u, n, false, 0.0); }; };
  solve(iterations)();  // both solves are timed with warm caches
  const double longer = least(calls, solve(iterations)), shorter = least(calls, solve(1));
  std::cout << "{\"evaluation\": " << calc << ", \"derivatives\": " << calc_diff << ", \"backward\": " << backward
            << ", \"forward with evaluation\": " << forward
            << ", \"whole iteration\": " << calc_diff + backward + forward << ", \"iteration of a solve\": "
            << scale * (longer - shorter) / static_cast<double>(iterations - 1) << "}" << std::endl;
}

int main(int argc, char** argv) try {
  if (argc != 2) throw std::runtime_error("expected the file of a problem");
  const Problem p = read_problem(argv[1]);
  crocoddyl::SolverFDDP solver(shooting_problem(p)), at_guess(shooting_problem(p));
  solver.set_th_stop(1e-30);  // every iteration is taken
  at_guess.setCandidate(p.x, p.u, false);
  at_guess.computeDirection(true);
  std::cout << std::setprecision(17);
  std::string command;
  while (std::cin >> command) {
    std::size_t iterations = 0;
    int calls = 0;
    if (command == "physics") write_physics(*at_guess.get_problem(), p);
    else if (command == "steps" && std::cin >> iterations) write_steps(solver, p, iterations);
    else if (command == "time" && std::cin >> calls >> iterations) write_times(solver, at_guess, p, calls, iterations);
    else throw std::runtime_error("unknown command: " + command);
  }
} catch (const std::exception& error) {
  std::cerr << "standing: " << error.what() << std::endl;
  return 1;
}
