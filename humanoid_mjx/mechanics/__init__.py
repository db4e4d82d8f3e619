"""Kinematics, dynamics and motions of serial chains."""
