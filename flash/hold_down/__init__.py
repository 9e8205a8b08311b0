"""The check of motors and gyro on an aircraft that is held, propellers on."""
