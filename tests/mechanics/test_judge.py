"""Native MuJoCo, by which the tree is judged, against itself: https://github.com/google-deepmind/mujoco/issues/3767."""

import mujoco
import numpy as np

LINK = '<body pos="0.1 0 0"><joint axis="{}"/><geom size="0.04" mass="0.1"/>'


def test_dense_and_sparse_jacobians_lead_to_the_same_accelerations():
    """A chain of 70 degrees of freedom on the ground, with contacts within it, beyond limits and with dry friction.
    MuJoCo 4.0.0 has a wrong Hessian in its sparse solver, which costs steps of the solver but not its minimum."""
    links = "".join(LINK.format("0 1 0" if index % 2 else "0 0.2 1") for index in range(64))
    model = mujoco.MjModel.from_xml_string(f"""<mujoco><option tolerance="0" ls_tolerance="1e-12"/>
    <default><joint range="-60 60" limited="true" frictionloss="0.01" damping="0.01" armature="0.001"/></default>
    <worldbody><geom type="plane" size="0 0 1"/>
    <body pos="0 0 0.039"><freejoint/><geom size="0.04" mass="0.1"/>{links}{"</body>" * 65}</worldbody>
    </mujoco>""")
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    for spread, steps in ((0.02, 20), (0.02, 20), (0.02, 60)):
        mujoco.mj_resetData(model, data)
        data.qpos[7:], data.qvel[:] = spread * rng.normal(size=64), 0.3 * rng.normal(size=70)
        model.opt.tolerance = 1e-8
        mujoco.mj_step(model, data, steps)
        state, found = (data.qpos.copy(), data.qvel.copy()), []
        model.opt.tolerance = 0.0
        for jacobian in (mujoco.mjtJacobian.mjJAC_DENSE, mujoco.mjtJacobian.mjJAC_SPARSE):
            model.opt.jacobian, data.qacc_warmstart[:] = jacobian, 0.0
            data.qpos, data.qvel = state
            mujoco.mj_forward(model, data)
            found.append(data.qacc.copy())
        assert data.ncon and data.nefc > 64
        assert np.linalg.norm(found[0] - found[1]) < 1e-9 * np.linalg.norm(found[0])
