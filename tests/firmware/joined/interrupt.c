/* An interrupt at a known instruction: whoever touches watched memory for the first time is interrupted there. */
#define _GNU_SOURCE
#include <signal.h>
#include <stddef.h>
#include <stdint.h>
#include <sys/mman.h>

static struct {
	uintptr_t first, end;
	void (*handler)(void);
	struct sigaction before;
} watched;

static void interrupt_touched(int number, siginfo_t *info, void *context)
{
	const uintptr_t at = (uintptr_t)info->si_addr;

	(void)number;
	(void)context;
	sigaction(SIGSEGV, &watched.before, NULL); /* any other touch is a fault, which comes again */
	if (at < watched.first || at >= watched.end)
		return;
	mprotect((void *)watched.first, watched.end - watched.first, PROT_READ | PROT_WRITE);
	watched.handler();
}

/* `pages`: whole ones. The handler runs once, and the instruction that touched them after it. */
int interrupt_at(void *pages, size_t bytes, void (*handler)(void))
{
	struct sigaction action = { .sa_sigaction = interrupt_touched, .sa_flags = SA_SIGINFO };

	watched.first = (uintptr_t)pages;
	watched.end = watched.first + bytes;
	watched.handler = handler;
	if (sigaction(SIGSEGV, &action, &watched.before) != 0)
		return -1;
	return mprotect(pages, bytes, PROT_NONE);
}
