"""What a user would pick instead of the flow: model-predictive control, LQR, pure pursuit, Stanley, on one plant."""
