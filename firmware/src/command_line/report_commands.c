/* Commands that tell what the firmware is and does. */
#include "command_line/command.h"
#include "common/nf_math.h"
#include "housekeeping/battery.h"
#include "policy.h"

#define NAME(name) #name,
static const char *const states[] = { NF_FLIGHT_STATES(NAME) };
static const char *const stops[] = { NF_STOP_CAUSES(NAME) };
static const char *const fallbacks[] = { NF_FALLBACK_CAUSES(NAME) };
static const char *const healths[] = { NF_GYRO_HEALTHS(NAME) };
static const char *const log_devices[] = { NF_LOG_DEVICES(NAME) };
static const char *const log_states[] = { NF_LOG_STATES(NAME) };
static const char *const log_errors[] = { NF_LOG_ERRORS(NAME) };
static const char *const tasks[] = { NF_TASKS(NAME) };
_Static_assert(sizeof tasks / sizeof tasks[0] == TASK_COUNT, "a name each");
#define REASON(name) { NF_ARMING_REASON_##name, #name },
static const struct {
	uint8_t bit;
	const char *name;
} reasons[] = { NF_ARMING_REASONS(REASON) };
static const char *const levels[] = { "not known", "good", "warning", "low" };
_Static_assert(BATTERY_LOW == sizeof levels / sizeof levels[0] - 1, "a word each");
static const char *const faults[] = { "none", "hard", "assert", "watchdog", "brown-out", "clock", "reset line" };
_Static_assert(FAULT_RESET == sizeof faults / sizeof faults[0] - 1, "a word each");

static const char *report_name(const char *const names[], size_t count, unsigned index)
{
	return index < count ? names[index] : "?";
}
#define NAME_OF(names, index) report_name(names, sizeof(names) / sizeof(names)[0], index)

bool command_version(const struct task_line *t)
{
	printer_say(t->out, COMMAND_VERSION " on %s, MSP API %u.%u, policy ", t->services->identity->target,
		    NF_MSP_API_MAJOR, NF_MSP_API_MINOR);
	command_say_policy(t);
	printer_end(t->out);
	return false;
}

bool command_mixer(const struct task_line *t)
{
	printer_line(t->out, "no mixer to choose: the policy gives each motor its fraction");
	return false;
}

/* --- status ----------------------------------------------------------------------------------------------------- */
static void status_state(const struct task_line *t)
{
	const uint32_t up_s = command_samples(t->cl) / t->status->gyro_rate_hz;

	printer_say(t->out, "state: %s, last stop %s, up %u s", NAME_OF(states, t->status->state),
		    NAME_OF(stops, t->status->stop_cause), (unsigned)up_s);
}

static void status_reasons(const struct task_line *t)
{
	printer_say(t->out, "arming forbidden by:");
	for (size_t i = 0; i < sizeof reasons / sizeof reasons[0]; ++i)
		if (t->status->arming_reasons >> reasons[i].bit & 1u)
			printer_say(t->out, " %s", reasons[i].name);
	if (t->status->arming_reasons == 0)
		printer_say(t->out, " nothing");
}

static void status_battery(const struct task_line *t)
{
	const struct firmware_status *s = t->status;

	printer_say(t->out, "battery: %s, ", NAME_OF(levels, s->battery_level));
	printer_fixed(t->out, s->volts, 2);
	printer_say(t->out, " V, %u cells, ", s->cells);
	printer_fixed(t->out, s->amps, 2);
	printer_say(t->out, " A, ");
	printer_fixed(t->out, s->drawn_mah, 0);
	printer_say(t->out, " mAh drawn");
}

static void status_policy(const struct task_line *t)
{
	const struct firmware_status *s = t->status;

	printer_say(t->out, "policy: ");
	command_say_policy(t);
	printer_say(t->out, ", %s, the %s flies, last fallback %s, refused for %s", s->policy_good ? "good" : "bad",
		    s->pid_flies ? "PID" : "policy", NAME_OF(fallbacks, s->fallback_cause),
		    NAME_OF(fallbacks, s->refused_cause));
}

static void status_load(const struct task_line *t)
{
	printer_say(t->out, "load: %u %% of a gyro period at most", t->status->load_percent);
}

static void status_motors(const struct task_line *t)
{
	const struct rotors *rotors = t->services->rotors;

	printer_say(t->out, "motors: %u, outputs that had stuck set up anew %u times", t->status->trace.motor_count,
		    (unsigned)t->services->motor_restarts(t->services->context));
	if (!rotors->on)
		return;
	unsigned worst = 0;
	printer_say(t->out, rotors->silent ? ", ESCs that are silent:" : ", all ESCs tell rotor speeds");
	for (unsigned i = 0; i < POLICY_ACTION_COUNT; ++i) {
		if (rotors->silent >> i & 1u)
			printer_say(t->out, " %u", i + 1u);
		else if (rotors->errors[i] > worst)
			worst = rotors->errors[i];
	}
	if (worst > 0)
		printer_say(t->out, ", up to %u.%u %% errors", worst / 100u, worst / 10u % 10u);
}

static void status_gyro(const struct task_line *t)
{
	const struct firmware_status *s = t->status;

	printer_say(t->out, "gyro: ");
	if (s->gyro_identity != 0)
		printer_say(t->out, "chip 0x%02x, ", s->gyro_identity);
	printer_say(t->out, "%u Hz, %s, ", s->gyro_rate_hz, NAME_OF(healths, s->gyro_health));
	printer_fixed(t->out, s->temperature_deg_c, 1);
	printer_say(t->out, " deg C");
}

static void status_receiver(const struct task_line *t)
{
	printer_say(t->out, "receiver: %s, quality %u %%", t->status->receiver_good ? "good" : "lost",
		    t->status->receiver_quality);
}

static void status_log(const struct task_line *t)
{
	struct blackbox_status log;

	blackbox_status(t->services->blackbox, &log);
	printer_say(t->out, "log: %s, %s, error %s, logs %u, dropped steps %u", NAME_OF(log_devices, log.chosen),
		    NAME_OF(log_states, log.device.state), NAME_OF(log_errors, log.device.error), log.device.logs,
		    (unsigned)log.dropped);
}

bool command_status(const struct task_line *t)
{
	static void (*const lines[])(const struct task_line *t) = {
		status_state,  status_reasons, status_battery,  status_policy, status_load,
		status_motors, status_gyro,    status_receiver, status_log,
	};

	lines[t->row](t);
	printer_end(t->out);
	return t->row + 1 < sizeof lines / sizeof lines[0];
}

/* --- tasks ------------------------------------------------------------------------------------------------------ */
static unsigned report_us(const struct task_line *t, uint32_t cycles)
{
	return (unsigned)(cycles / (t->services->cycles_hz / 1000000u));
}

bool command_tasks(const struct task_line *t)
{
	if (t->row == 0) {
		printer_line(t->out, "task        rate Hz       runs    misses  worst us   best us   mean us");
		return true;
	}
	const unsigned index = t->row - 1;
	const struct task_stats *task = &t->services->tasks[index];
	const char *const begin = t->out->at;
	printer_say(t->out, "%s", tasks[index]);
	while (t->out->at < begin + 10)
		printer_say(t->out, " ");
	printer_line(t->out, "%9u%11u%10u%10u%10u%10u", (unsigned)task->rate_hz, (unsigned)task->runs,
		     (unsigned)task->misses, report_us(t, task->worst), report_us(t, task->best),
		     report_us(t, task_stats_mean(task)));
	return t->row < TASK_COUNT;
}

/* --- faults ----------------------------------------------------------------------------------------------------- */
static void faults_show(const struct task_line *t)
{
	const struct fault_log *log = t->services->faults;
	const struct fault_record *record = &log->record;

	printer_say(t->out, "boots: %u, ", (unsigned)log->boots);
	if (!log->pending) {
		printer_line(t->out, "no fault is pending");
		return;
	}
	printer_line(t->out,
		     "pending: %s found by boot %u, %u control steps after its start, pc %08x cfsr %08x %.*s:%u; "
		     "'faults ack' allows arming again",
		     NAME_OF(faults, record->kind), (unsigned)log->boot, (unsigned)record->uptime_steps,
		     (unsigned)record->pc, (unsigned)record->cfsr, (int)sizeof record->file, record->file,
		     (unsigned)record->line);
}

static void faults_acknowledge(const struct task_line *t)
{
	const struct services *s = t->services;
	enum nf_refusal refusal = s->storing(s->context, true);

	if (refusal != NF_REFUSAL_NONE) {
		command_error(t);
		printer_line(t->out, "faults ack: " COMMAND_ARMED);
		return;
	}
	refusal = s->acknowledge(s->context);
	(void)s->storing(s->context, false);
	if (refusal != NF_REFUSAL_NONE) {
		command_error(t);
		printer_line(t->out, "faults ack: flash did not take it, the fault stays pending; try again");
	} else {
		printer_line(t->out, "acknowledged: faults, and a policy that was refused in flight");
	}
}

bool command_faults(const struct task_line *t)
{
	if (t->arguments[0] == '\0') {
		faults_show(t);
	} else if (command_is(t->arguments, "ack")) {
		faults_acknowledge(t);
	} else {
		command_got(t, "faults", t->arguments);
		printer_line(t->out, "nothing or 'ack'");
	}
	return false;
}
