// Reads a depth correction exported by Plumb (format `depth`) and converts raw depth readings to meters.
#pragma once
#include <algorithm>
#include <cmath>
#include <fstream>
#include <sstream>
#include <string>
#include <vector>

struct DepthCorrection {
  int width = 0, height = 0, cols = 0, rows = 0, invalid = -1;
  bool disparity = false, in_depth = false;
  double first = 0, second = 0, nearest = 0, farthest = 0;  // of `reading`, and of `seen`
  std::vector<std::vector<double>> nodes;                   // power by power

  explicit DepthCorrection(const std::string& path) {
    std::ifstream file(path);
    for (std::string line, key, word; std::getline(file, line);) {
      std::istringstream in(line);
      if (!(in >> key) || key[0] == '#') continue;
      if (key == "size") in >> width >> height;
      if (key == "reading") disparity = (in >> word >> first >> second, word == "disparity");
      if (key == "invalid") in >> invalid;
      if (key == "quantity") in_depth = (in >> word, word == "depth");
      if (key == "seen") in >> nearest >> farthest;
      if (key == "cells") in >> cols >> rows;
      if (key == "nodes") for (nodes.emplace_back(); in >> word;) nodes.back().push_back(std::stod(word));
    }
  }

  // The first of the four nodes that matter at a pixel, and their weights; one node without cells.
  static int weights(int pixel, int length, int cells, double w[4]) {
    if (cells == 0) return w[0] = 1, w[1] = w[2] = w[3] = 0, 0;
    const double along = (pixel + 0.5) / length * cells;
    const int start = std::min(static_cast<int>(along), cells - 1);
    const double t = along - start, s = 1 - t;
    w[0] = s * s * s / 6, w[1] = (3 * t * t * t - 6 * t * t + 4) / 6;
    return w[2] = (-3 * t * t * t + 3 * t * t + 3 * t + 1) / 6, w[3] = t * t * t / 6, start;
  }

  // Depth in meters of the reading `raw` at column u, row v; 0 where nothing was measured.
  double meters(int u, int v, int raw) const {
    double inverse = disparity ? first + second * raw : 1 / (first * raw);
    if (raw == invalid || !std::isfinite(inverse) || inverse <= 0) return 0;
    if (nodes.empty()) return 1 / inverse;
    double wx[4], wy[4], x = in_depth ? 1 / inverse : inverse, term = 1;
    const int i = weights(u, width, cols, wx), j = weights(v, height, rows, wy), stride = cols ? cols + 3 : 1;
    const double held = std::clamp(inverse, 1 / farthest, 1 / nearest), factor = in_depth ? 1 / held : held;
    for (const auto& g : nodes) {
      for (int b = 0; b < (rows ? 4 : 1); ++b)
        for (int a = 0; a < (cols ? 4 : 1); ++a) x += term * wx[a] * wy[b] * g[(j + b) * stride + i + a];
      term *= factor;
    }
    return x > 0 ? (in_depth ? x : 1 / x) : 0;
  }
};
