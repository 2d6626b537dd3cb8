"""A first policy: behaviour cloning that a laptop's processor trains in minutes.

A small network denoises a chunk of future joint targets, given the joints' positions and a summary
of the cloud of points (the recipe of Diffusion Policy, Chi et al. 2023, and DP3, Ze et al. 2024,
without convolutions). Needs `pip install 'akrobat[policy]'`.

    python -m akrobat.policy train DATASET --trajectories 50 -o POLICY
    akrobat eval TASK.toml --policy POLICY --trajectories TRAJECTORIES.h5 -o TRIALS
    python -m akrobat.policy curve TRIALS... -o curve.svg
"""
