// Plays a motion of `dynident excite` on an arm of Franka by libfranka, and records it for `dynident identify`.
//
//   g++ -std=c++17 -O2 play_franka.cpp -o play_franka -lfranka
//   ./play_franka ROBOT_ADDRESS motion.csv motion_recorded.csv
//
// Move the arm to where the motion starts before: it refuses to start where a joint is further than 0.02 rad from there.
// The rest of the way is made up for in two seconds. It commands positions, at 1 kHz, with quintics between the rows.
// Keep a hand on the stop. Contact and collisions are watched as libfranka does by default: fast motion may need other
// thresholds (Robot::setCollisionBehavior). The exit code is 0 where the motion was played to its end.

#include <array>
#include <cmath>
#include <exception>
#include <fstream>
#include <iostream>
#include <sstream>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include <franka/exception.h>
#include <franka/robot.h>

constexpr std::size_t kJoints = 7;
constexpr double kStartTolerance = 0.02;  // rad
constexpr double kBlend = 2.0;            // s, from where the arm stands to the first row
using Joints = std::array<double, kJoints>;

struct Row {
  double t;
  Joints q, dq, ddq;
};

struct Motion {
  std::vector<std::string> names;
  std::vector<Row> rows;
};

Motion read(const std::string& path) {
  std::ifstream file(path);
  if (!file) throw std::runtime_error(path + ": cannot be read.");
  Motion motion;
  std::string line, cell;
  std::getline(file, line);
  std::istringstream head(line);
  while (std::getline(head, cell, ',')) {
    if (cell.rfind("q_", 0) == 0) motion.names.push_back(cell.substr(2));
  }
  if (motion.names.size() != kJoints) throw std::runtime_error(path + ": has not the positions q_... of seven joints.");
  while (std::getline(file, line)) {
    std::istringstream text(line);
    std::vector<double> values;
    while (std::getline(text, cell, ',')) values.push_back(std::stod(cell));
    if (values.size() != 1 + 3 * kJoints) throw std::runtime_error(path + ": a row has not 22 numbers.");
    Row row{values[0], {}, {}, {}};
    for (std::size_t j = 0; j < kJoints; ++j) {
      row.q[j] = values[1 + j];
      row.dq[j] = values[1 + kJoints + j];
      row.ddq[j] = values[1 + 2 * kJoints + j];
    }
    motion.rows.push_back(row);
  }
  if (motion.rows.size() < 2) throw std::runtime_error(path + ": has no motion.");
  return motion;
}

// The quintic between two rows that has their positions, velocities and accelerations.
Joints between(const Row& a, const Row& b, double t) {
  const double T = b.t - a.t, s = t - a.t;
  Joints q{};
  for (std::size_t j = 0; j < kJoints; ++j) {
    const double d = (b.q[j] - a.q[j] - (a.dq[j] + a.ddq[j] * T / 2) * T) / (T * T * T);
    const double e = (b.dq[j] - a.dq[j] - a.ddq[j] * T) / (T * T);
    const double f = (b.ddq[j] - a.ddq[j]) / T;
    const double c3 = 10 * d - 4 * e + f / 2, c4 = (-15 * d + 7 * e - f) / T, c5 = (6 * d - 3 * e + f / 2) / (T * T);
    q[j] = a.q[j] + s * (a.dq[j] + s * (a.ddq[j] / 2 + s * (c3 + s * (c4 + s * c5))));
  }
  return q;
}

int main(int count, char** words) {
  if (count != 4) {
    std::cerr << "usage: play_franka ROBOT_ADDRESS motion.csv motion_recorded.csv\n";
    return 2;
  }
  std::vector<std::pair<double, franka::RobotState>> recorded;
  try {
    const Motion motion = read(words[2]);
    const std::vector<Row>& rows = motion.rows;
    franka::Robot robot(words[1]);
    const franka::RobotState here = robot.readOnce();
    for (std::size_t j = 0; j < kJoints; ++j) {
      if (!(std::abs(here.q[j] - rows[0].q[j]) <= kStartTolerance)) {
        std::cerr << motion.names[j] << " is at " << here.q[j] << "; move it to " << rows[0].q[j]
                  << ", where the motion starts.\n";
        return 1;
      }
    }
    recorded.reserve(static_cast<std::size_t>(1100 * (kBlend + rows.back().t)));
    double time = -kBlend;
    std::size_t k = 0;
    Joints begin{};
    bool has_begun = false;
    robot.control([&](const franka::RobotState& state, franka::Duration period) -> franka::JointPositions {
      time += period.toSec();
      if (!has_begun) begin = state.q_d;  // the first command must be where the arm is told to be
      has_begun = true;
      if (time < 0) {
        const double s = 1 + time / kBlend, share = s * s * s * (10 + s * (6 * s - 15));
        Joints q{};
        for (std::size_t j = 0; j < kJoints; ++j) q[j] = begin[j] + share * (rows[0].q[j] - begin[j]);
        return franka::JointPositions(q);
      }
      recorded.emplace_back(time, state);
      if (time >= rows.back().t) return franka::MotionFinished(franka::JointPositions(rows.back().q));
      while (rows[k + 1].t <= time) ++k;
      return franka::JointPositions(between(rows[k], rows[k + 1], time));
    });
    std::ofstream file(words[3]);
    file.precision(12);
    file << "t";
    for (const std::string& name : motion.names) file << ",q_" << name;
    for (const std::string& name : motion.names) file << ",tau_" << name;
    file << "\n";
    for (const auto& [t, state] : recorded) {
      file << t;
      for (double q : state.q) file << "," << q;
      for (double tau : state.tau_J) file << "," << tau;
      file << "\n";
    }
    if (!file.flush()) throw std::runtime_error(std::string(words[3]) + ": cannot be written.");
  } catch (const franka::Exception& error) {
    std::cerr << "libfranka: " << error.what() << "\n";
    return 1;
  } catch (const std::exception& error) {
    std::cerr << error.what() << "\n";
    return 1;
  }
  return 0;
}
