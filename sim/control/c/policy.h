/* Stands where the firmware has the header of its policy: PID and filters ask it for the number of motors,
 * POLICY_ACTION_COUNT, which the build of this library says. */
