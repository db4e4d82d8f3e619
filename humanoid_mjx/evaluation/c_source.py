"""A policy as plain C for the processor of a robot: one file, no library but the C library's mathematics."""

import json
from typing import Any

import jax
import numpy as np

from humanoid_mjx.evaluation.policy import StoredPolicy
from humanoid_mjx.learners.approximate import Weights
from humanoid_mjx.learners.deep import DeepQ, QNetwork
from humanoid_mjx.learners.normalisation import MAX_DEVIATIONS
from humanoid_mjx.spec import InputError

EPSILON = 1e-6
"""Added to variances by `normalise` and by Flax's `LayerNorm`."""

HEAD = """/* The policy "{name}" of humanoid_mjx, by {learner} on the task {task}.

   void act(const float obs[{size}], int action[{joints}]) gives the number of the best choice of each joint, from 0.
   void q_values(const float obs[{size}], float q[{joints}][{bins}]) gives the value of each choice.
   Of equal choices the first is taken. Single precision; compile it with -lm. */
#include <math.h>
"""

BODY = """
static const int choices[{joints}] = {choices};

static void dense(int rows, int columns, const float *weights, const float *bias, const float *x, float *y) {{
  for (int j = 0; j < columns; j++) y[j] = bias[j];
  for (int i = 0; i < rows; i++)
    for (int j = 0; j < columns; j++) y[j] += x[i] * weights[i * columns + j];
}}

/* Layer normalisation, then the larger of 0 and the result. */
static void normalise(int size, const float *scale, const float *bias, float *x) {{
  float mean = 0, variance = 0;
  for (int i = 0; i < size; i++) mean += x[i] / size;
  for (int i = 0; i < size; i++) variance += (x[i] - mean) * (x[i] - mean) / size;
  for (int i = 0; i < size; i++) x[i] = fmaxf(0, (x[i] - mean) / sqrtf(variance + {epsilon}f) * scale[i] + bias[i]);
}}

void q_values(const float obs[{size}], float q[{joints}][{bins}]) {{
  float x0[{size}];
  for (int i = 0; i < {size}; i++)
    x0[i] = fminf(fmaxf((obs[i] - mean[i]) / sqrtf(variance[i] + {epsilon}f), -{most}f), {most}f);
{layers}}}

void act(const float obs[{size}], int action[{joints}]) {{
  float q[{joints}][{bins}];
  q_values(obs, q);
  for (int joint = 0; joint < {joints}; joint++) {{
    action[joint] = 0;
    for (int k = 1; k < choices[joint]; k++)
      if (q[joint][k] > q[joint][action[joint]]) action[joint] = k;
  }}
}}
"""


def c_source(trained: StoredPolicy) -> str:
    """The C source of a policy of `deep_q`: functions `act` and `q_values` of a raw observation.

    Raises:
      InputError: the policy is of another learner.
    """
    learner, weights = trained.learner, trained.policy
    if not isinstance(learner, DeepQ) or not isinstance(weights, Weights):
        name = trained.config.learner["name"]
        raise InputError(f"{trained.name}: only policies of deep_q can be written as C; this one is of {name}.")
    network, own = learner.network(), ("preprocess", "q_values", "act")
    if type(network) is not QNetwork or any(getattr(type(learner), part) is not getattr(DeepQ, part) for part in own):
        raise InputError(f"{trained.name}: a network of one's own cannot be written as C, deep_q's can; write an .npz.")
    layers: dict[str, Any] = jax.tree.map(np.asarray, weights.value)["params"]
    size, joints, bins = learner.env.observation_size, len(learner.env.action_bins), learner.bins
    arrays = {"mean": weights.moments.mean, "variance": weights.moments.variance}
    steps, rows = [], size
    for number in range(network.layers + 1):
        own = layers[f"Dense_{number}"]
        columns, last = own["bias"].size, number == network.layers
        arrays |= {f"w{number}": own["kernel"], f"b{number}": own["bias"]}
        target = "&q[0][0]" if last else f"x{number + 1}"
        steps += [] if last else [f"float {target}[{columns}];"]
        steps.append(f"dense({rows}, {columns}, w{number}, b{number}, x{number}, {target});")
        if not last:
            norm = layers[f"LayerNorm_{number}"]
            arrays |= {f"scale{number}": norm["scale"], f"shift{number}": norm["bias"]}
            steps.append(f"normalise({columns}, scale{number}, shift{number}, {target});")
        rows = columns
    task, kind = trained.config.task["name"], trained.config.learner["name"]
    sizes: dict[str, Any] = {"size": size, "joints": joints, "bins": bins}
    words = {"name": json.dumps(trained.name)[1:-1].replace("*/", ""), "learner": kind, "task": task}
    numbers = "".join(f"static const float {name}[{np.size(x)}] = {_braced(x)};\n" for name, x in arrays.items())
    choices = "{" + ", ".join(map(str, learner.env.action_bins)) + "}"
    body = BODY.format(
        **sizes, choices=choices, epsilon=EPSILON, most=MAX_DEVIATIONS, layers="".join(f"  {step}\n" for step in steps)
    )
    return HEAD.format(**sizes, **words) + numbers + body


def _braced(array: Any) -> str:
    """The numbers of an array, with all digits of single precision."""
    numbers = (f"{x:.9e}f" for x in np.ravel(np.asarray(array, np.float32)).tolist())
    return "{" + ", ".join(numbers) + "}"
