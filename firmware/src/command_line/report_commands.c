/* Commands that tell what the firmware is and does. */
#include "command_line/command.h"
#include "command_line/reply.h"
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

static void report_name(struct printer *out, const char *label, const char *const names[], size_t count, unsigned index)
{
	printer_text(out, label);
	printer_text(out, index < count ? names[index] : "?");
}
#define REPORT_NAME(out, label, names, index) report_name(out, label, names, sizeof(names) / sizeof(names)[0], index)

bool command_version(const struct task_line *t)
{
	command_say_version(t);
	printer_text(t->out, " on ");
	printer_text(t->out, t->services->identity->target);
	printer_text(t->out, ", MSP API ");
	printer_number(t->out, NF_MSP_API_MAJOR);
	printer_char(t->out, '.');
	printer_number(t->out, NF_MSP_API_MINOR);
	printer_text(t->out, ", policy ");
	command_say_policy(t);
	printer_end(t->out);
	return false;
}

bool command_mixer(const struct task_line *t)
{
	printer_text(t->out, "no mixer to choose: the policy gives each motor its fraction");
	printer_end(t->out);
	return false;
}

/* --- status ----------------------------------------------------------------------------------------------------- */
static void status_state(const struct task_line *t)
{
	REPORT_NAME(t->out, "state: ", states, t->status->state);
	REPORT_NAME(t->out, ", last stop ", stops, t->status->stop_cause);
	printer_text(t->out, ", up ");
	printer_number(t->out, t->services->samples(t->services->context) / t->status->gyro_rate_hz);
	printer_text(t->out, " s");
}

static void status_reasons(const struct task_line *t)
{
	bool any = false;

	printer_text(t->out, "arming forbidden by:");
	for (size_t i = 0; i < sizeof reasons / sizeof reasons[0]; ++i) {
		if ((t->status->arming_reasons >> reasons[i].bit & 1u) == 0)
			continue;
		printer_char(t->out, ' ');
		printer_text(t->out, reasons[i].name);
		any = true;
	}
	printer_text(t->out, any ? "" : " nothing");
}

static void status_battery(const struct task_line *t)
{
	const struct firmware_status *s = t->status;

	REPORT_NAME(t->out, "battery: ", levels, s->battery_level);
	printer_text(t->out, ", ");
	printer_fixed(t->out, s->volts, 2);
	printer_text(t->out, " V, ");
	printer_number(t->out, s->cells);
	printer_text(t->out, " cells, ");
	printer_fixed(t->out, s->amps, 2);
	printer_text(t->out, " A, ");
	printer_fixed(t->out, s->drawn_mah, 0);
	printer_text(t->out, " mAh drawn");
}

static void status_policy(const struct task_line *t)
{
	const struct firmware_status *s = t->status;

	printer_text(t->out, "policy: ");
	command_say_policy(t);
	printer_text(t->out, s->policy_good ? ", good, " : ", bad, ");
	printer_text(t->out, s->pid_flies ? "the PID flies" : "the policy flies");
	REPORT_NAME(t->out, ", last fallback ", fallbacks, s->fallback_cause);
	REPORT_NAME(t->out, ", refused for ", fallbacks, s->refused_cause);
}

static void status_load(const struct task_line *t)
{
	printer_text(t->out, "load: ");
	printer_number(t->out, t->status->load_percent);
	printer_text(t->out, " % of a gyro period at most");
}

static void status_motors(const struct task_line *t)
{
	printer_text(t->out, "motors: ");
	printer_number(t->out, t->status->trace.motor_count);
	printer_text(t->out, ", outputs that had stuck set up anew ");
	printer_number(t->out, t->services->motor_restarts(t->services->context));
	printer_text(t->out, " times");
}

static void status_gyro(const struct task_line *t)
{
	const struct firmware_status *s = t->status;

	printer_text(t->out, "gyro: ");
	if (s->gyro_identity != 0) {
		printer_text(t->out, "chip 0x");
		printer_hex(t->out, s->gyro_identity, 2);
		printer_text(t->out, ", ");
	}
	printer_number(t->out, s->gyro_rate_hz);
	REPORT_NAME(t->out, " Hz, ", healths, s->gyro_health);
	printer_text(t->out, ", ");
	printer_fixed(t->out, s->temperature_deg_c, 1);
	printer_text(t->out, " deg C");
}

static void status_receiver(const struct task_line *t)
{
	printer_text(t->out, t->status->receiver_good ? "receiver: good, quality " : "receiver: lost, quality ");
	printer_number(t->out, t->status->receiver_quality);
	printer_text(t->out, " %");
}

static void status_log(const struct task_line *t)
{
	struct blackbox_status log;

	blackbox_status(t->services->blackbox, &log);
	REPORT_NAME(t->out, "log: ", log_devices, log.chosen);
	REPORT_NAME(t->out, ", ", log_states, log.device.state);
	REPORT_NAME(t->out, ", error ", log_errors, log.device.error);
	printer_text(t->out, ", logs ");
	printer_number(t->out, log.device.logs);
	printer_text(t->out, ", dropped steps ");
	printer_number(t->out, log.dropped);
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
static uint32_t report_us(const struct task_line *t, uint32_t cycles)
{
	return cycles / (t->services->cycles_hz / 1000000u);
}

bool command_tasks(const struct task_line *t)
{
	if (t->row == 0) {
		printer_text(t->out, "task        rate Hz       runs    misses  worst us   best us   mean us");
		printer_end(t->out);
		return true;
	}
	const unsigned index = t->row - 1;
	const struct task_stats *task = &t->services->tasks[index];
	const char *const begin = t->out->at;
	printer_text(t->out, tasks[index]);
	while (t->out->at < begin + 10)
		printer_char(t->out, ' ');
	printer_column(t->out, task->rate_hz, 9);
	printer_column(t->out, task->runs, 11);
	printer_column(t->out, task->misses, 10);
	printer_column(t->out, report_us(t, task->worst), 10);
	printer_column(t->out, report_us(t, task->best), 10);
	printer_column(t->out, report_us(t, task_stats_mean(task)), 10);
	printer_end(t->out);
	return t->row < TASK_COUNT;
}

/* --- faults ----------------------------------------------------------------------------------------------------- */
static void faults_show(const struct task_line *t)
{
	const struct fault_log *log = t->services->faults;
	const struct fault_record *record = &log->record;

	printer_text(t->out, "boots: ");
	printer_number(t->out, log->boots);
	if (!log->pending) {
		printer_text(t->out, ", no fault is pending");
		printer_end(t->out);
		return;
	}
	REPORT_NAME(t->out, ", pending: ", faults, record->kind);
	printer_text(t->out, " found by boot ");
	printer_number(t->out, log->boot);
	printer_text(t->out, ", ");
	printer_number(t->out, record->uptime_steps);
	printer_text(t->out, " control steps after its start, pc ");
	printer_hex(t->out, record->pc, 8);
	printer_text(t->out, " cfsr ");
	printer_hex(t->out, record->cfsr, 8);
	printer_char(t->out, ' ');
	printer_part(t->out, record->file, sizeof record->file);
	printer_char(t->out, ':');
	printer_number(t->out, record->line);
	printer_text(t->out, "; 'faults ack' allows arming again");
	printer_end(t->out);
}

static void faults_acknowledge(const struct task_line *t)
{
	const struct command_line_services *s = t->services;
	enum nf_refusal refusal = s->storing(s->context, true);

	if (refusal != NF_REFUSAL_NONE) {
		command_error(t);
		printer_text(t->out, "faults ack: ");
		command_say_armed(t);
		return;
	}
	refusal = s->acknowledge(s->context);
	(void)s->storing(s->context, false);
	if (refusal != NF_REFUSAL_NONE) {
		command_error(t);
		printer_text(t->out, "faults ack: flash did not take it, the fault stays pending; try again");
	} else {
		printer_text(t->out, "acknowledged: faults, and a policy that was refused in flight");
	}
	printer_end(t->out);
}

bool command_faults(const struct task_line *t)
{
	if (t->arguments[0] == '\0') {
		faults_show(t);
	} else if (command_is(t->arguments, "ack")) {
		faults_acknowledge(t);
	} else {
		command_got(t, "faults", t->arguments);
		printer_text(t->out, "nothing or 'ack'");
		printer_end(t->out);
	}
	return false;
}
