/* Projected gradient descent on the generated function `jseq`: descend X Y YAW X_LOW Y_LOW X_HIGH Y_HIGH */
#include <stdio.h>
#include <stdlib.h>

#include "jseq.h"

static const double **arg;
static double **res, *w;
static casadi_int *iw;
static long evaluations;

static double evaluate(const double *xi, double *gradient) {
  double cost;
  arg[0] = xi;
  res[0] = &cost;
  res[1] = gradient; /* a null pointer leaves the gradient unwritten */
  if (jseq(arg, res, iw, w, 0)) exit(1);
  ++evaluations;
  return cost;
}

static double within(double value, double low, double high) {
  return value < low ? low : value > high ? high : value;
}

int main(int argc, char **argv) {
  casadi_int sz_arg, sz_res, sz_iw, sz_w;
  double xi[3], trial[3], gradient[3], low[2], high[2], cost, step = 1e-3;
  if (argc != 8) return 2;
  for (int k = 0; k < 3; ++k) xi[k] = atof(argv[1 + k]);
  for (int k = 0; k < 2; ++k) low[k] = atof(argv[4 + k]), high[k] = atof(argv[6 + k]);

  jseq_work(&sz_arg, &sz_res, &sz_iw, &sz_w);
  arg = calloc(sz_arg + 1, sizeof *arg);
  res = calloc(sz_res + 1, sizeof *res);
  iw = calloc(sz_iw + 1, sizeof *iw);
  w = calloc(sz_w + 1, sizeof *w);

  cost = evaluate(xi, gradient);
  printf("iteration   0: J_seq = %.4f\n", cost);
  for (int i = 1; i <= 200 && step > 1e-12; ++i) {
    for (;; step /= 2) { /* shorter steps until one helps, then a longer one for the next iteration */
      for (int k = 0; k < 3; ++k) trial[k] = xi[k] - step * gradient[k];
      for (int k = 0; k < 2; ++k) trial[k] = within(trial[k], low[k], high[k]);
      if (evaluate(trial, NULL) < cost || step < 1e-12) break;
    }
    for (int k = 0; k < 3; ++k) xi[k] = trial[k];
    cost = evaluate(xi, gradient);
    step *= 3;
    if (i % 50 == 0) printf("iteration %3d: J_seq = %.4f\n", i, cost);
  }
  printf("C, %ld evaluations:       J_seq = %.4f at [%.4f %.4f %.4f]\n", evaluations, cost, xi[0], xi[1], xi[2]);
  return 0;
}
