"""The paper's released simulator as a process of its own: it learns once for every line that it reads.

    python released_program.py CODE TASK

CODE is a checkout of the released code, TASK the arrays of `Task.save`. Only NumPy and Taichi are imported.
Each answer is one line of JSON: seconds by the clock and of
processor time, and the losses of the first pass [m].
"""

import contextlib
import json
import os
import pickle
import sys
import tempfile
import time

import numpy as np


def robots_of(arrays):
    """Bodies and their first controllers, in the layout of the released code."""
    bodies, controllers = {"points": [], "springs": []}, []
    for i in range(sum(name.startswith("positions") for name in arrays)):
        springs, active = arrays[f"springs{i}"], arrays[f"active{i}"]
        stiffness = np.full(len(springs), 3.0e4)
        bodies["points"].append(arrays[f"positions{i}"])
        bodies["springs"].append(
            np.column_stack([springs, arrays[f"rest_lengths{i}"], stiffness, 0.1 * active])
        )
        # Two more inputs, constant 1, and an output for every spring, of which only motors' count.
        w1 = np.pad(arrays[f"w1{i}"], [(0, 0), (0, 2)])
        w2, b2 = np.zeros((len(springs), 32)), np.zeros(len(springs))
        w2[active], b2[active] = arrays[f"w2{i}"], arrays[f"b2{i}"]
        controllers.append((w1, arrays[f"b1{i}"], w2, b2))
    return bodies, controllers


def main():
    answers = os.fdopen(os.dup(1), "w")
    code, task = sys.argv[1:]
    sys.path.insert(0, code)
    arrays = dict(np.load(task))
    bodies, controllers = robots_of(arrays)
    with contextlib.redirect_stdout(sys.stderr):
        import taichi as ti
        from simulator import sim

        ti.init(default_fp=ti.f64, arch=ti.cpu)
        sim.set_ti_globals()
        with tempfile.NamedTemporaryFile() as file:
            file.write(pickle.dumps(bodies))
            file.flush()
            sim.setup(file.name, None)
        for _ in sys.stdin:
            for i, weights in enumerate(controllers):
                sim.fill_weights_ti(i, *(np.ascontiguousarray(w) for w in weights))
            ti.sync()
            began, spent, first = time.perf_counter(), time.process_time(), None
            for _ in range(int(arrays["iterations"])):
                sim.clear()
                sim.forward()
                first = sim.loss.to_numpy() if first is None else first
                sim.loss.grad.fill(1.0)
                sim.manual_backward()
                sim.update_weights()
            sim.clear()
            sim.forward()
            sim.loss.to_numpy()
            took = [time.perf_counter() - began, time.process_time() - spent]
            print(json.dumps([*took, first.tolist()]), file=answers, flush=True)


if __name__ == "__main__":
    main()
