//! Particle swarm with constriction, ask/tell, counter-based random streams; checkpoints.
