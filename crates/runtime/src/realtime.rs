//! Real-time scheduling of the threads that a robot waits for.

use thread_priority::{
    RealtimeThreadSchedulePolicy, ThreadPriority, ThreadPriorityValue, ThreadSchedulePolicy,
    set_thread_priority_and_policy, thread_native_id,
};

/// Runs the calling thread as `SCHED_FIFO` with this priority (1 to 99; ros2_control's loop has 50), or as
/// before where the system does not allow it; the log says which. 0 changes nothing. Threads that it
/// starts from then on inherit it.
///
/// True when it was done.
pub fn request(thread: &str, priority: u8) -> bool {
    if priority == 0 {
        return false;
    }
    let set = ThreadPriorityValue::try_from(priority).map_err(|e| e.to_owned()).and_then(|value| {
        set_thread_priority_and_policy(
            thread_native_id(),
            ThreadPriority::Crossplatform(value),
            ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo),
        )
        .map_err(|e| format!("{e:?}"))
    });
    match &set {
        Ok(()) => tracing::debug!("{thread}: SCHED_FIFO, priority {priority}"),
        Err(why) => tracing::info!(
            "{thread}: no real-time scheduling ({why}); cycles may be late under load. To allow it, give \
             the user 'rtprio 99' in /etc/security/limits.conf"
        ),
    }
    set.is_ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use thread_priority::thread_schedule_policy;

    #[test]
    fn the_thread_is_scheduled_as_it_is_told() {
        std::thread::spawn(|| {
            let before = thread_schedule_policy().unwrap();
            assert!(!request("test", 0));
            assert_eq!(thread_schedule_policy().unwrap(), before);
            let done = request("test", 10);
            let fifo = ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo);
            assert_eq!(thread_schedule_policy().unwrap() == fifo, done);
            assert!(!request("test", 100), "there is no such priority");
        })
        .join()
        .unwrap();
    }
}
