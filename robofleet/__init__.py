"""robofleet: deployment of differential-drive fleets under an overhead camera. The rooms are explained in README.md."""
