"""The learned feasibility energy ``E(T, g)``: features, network, training, calibration, storage and CasADi export."""

from regrasp_opt.energy.model import EnergyModel, GraspEnergy

__all__ = ["EnergyModel", "GraspEnergy"]
