// The phases of a run in words.

export const PHASES = {
  starting: "Starting",
  idle: "Idle",
  armed: "Arming",
  positioning: "Going to start",
  running: "Running",
  parking: "Parking",
  ending: "Ending",
  hold: "HOLD",
  fault: "FAULT",
  estop: "EMERGENCY STOP",
};
