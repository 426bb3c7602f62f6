use super::{LaunchError, NodeCommand};
use std::fs::File;
#[cfg(target_os = "linux")]
use std::os::unix::process::CommandExt as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

/// How programs are started.
#[derive(Debug, Clone)]
pub struct StartOptions {
    /// Folder of the executables.
    pub binaries: PathBuf,
    /// Where each node's output goes, `NAME.log`; none: to the terminal.
    pub log_folder: Option<PathBuf>,
    /// Added to every node's environment.
    pub environment: Vec<(String, String)>,
}

impl StartOptions {
    /// Executables beside the running program, output to the terminal.
    pub fn beside_this_program() -> Self {
        let binaries = std::env::current_exe()
            .ok()
            .and_then(|p| p.parent().map(Path::to_owned))
            .unwrap_or_else(|| PathBuf::from("."));
        Self { binaries, log_folder: None, environment: Vec::new() }
    }
}

struct Running {
    command: NodeCommand,
    child: Child,
    status: Option<ExitStatus>,
}

/// A node that ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NodeExit {
    /// Its name.
    pub name: String,
    /// Exit code, none when a signal ended it.
    pub code: Option<i32>,
}

/// Running programs; dropping it ends them.
pub struct Launched {
    options: StartOptions,
    nodes: Vec<Running>,
}

impl Launched {
    /// Starts all programs. If one cannot be started the others are ended. They get SIGTERM when the
    /// calling thread ends, so that a killed program leaves no nodes behind; call it from a thread that
    /// stays, such as that of `main`.
    ///
    /// # Errors
    /// [`LaunchError::Start`].
    pub fn start(commands: &[NodeCommand], options: StartOptions) -> Result<Self, LaunchError> {
        let mut launched = Self { options, nodes: Vec::new() };
        for command in commands {
            let child = launched.spawn(command)?;
            launched.nodes.push(Running { command: command.clone(), child, status: None });
        }
        Ok(launched)
    }

    fn spawn(&self, command: &NodeCommand) -> Result<Child, LaunchError> {
        let program = self.options.binaries.join(&command.executable);
        let error = |source| LaunchError::Start { program: program.clone(), source };
        let mut process = Command::new(&program);
        process
            .args(&command.arguments)
            .envs(self.options.environment.iter().cloned())
            .envs(command.environment.iter().cloned())
            .stdin(Stdio::null());
        if let Some(folder) = &self.options.log_folder {
            std::fs::create_dir_all(folder).map_err(error)?;
            let log = File::options()
                .create(true)
                .append(true)
                .open(folder.join(format!("{}.log", command.name)))
                .map_err(error)?;
            process.stdout(log.try_clone().map_err(error)?).stderr(log);
        }
        end_with_this_thread(&mut process);
        process.spawn().map_err(error)
    }

    /// Names of the nodes.
    pub fn names(&self) -> Vec<&str> {
        self.nodes.iter().map(|n| n.command.name.as_str()).collect()
    }

    /// Process id of a running node.
    pub fn pid(&self, name: &str) -> Option<u32> {
        self.nodes
            .iter()
            .find(|n| n.command.name == name && n.status.is_none())
            .map(|n| n.child.id())
    }

    /// Nodes that have ended since the last call.
    pub fn exited(&mut self) -> Vec<NodeExit> {
        let mut out = Vec::new();
        for n in self.nodes.iter_mut().filter(|n| n.status.is_none()) {
            if let Ok(Some(status)) = n.child.try_wait() {
                n.status = Some(status);
                out.push(NodeExit { name: n.command.name.clone(), code: status.code() });
            }
        }
        out
    }

    /// Ends a node at once (SIGKILL); false when there is none of that name running.
    pub fn kill(&mut self, name: &str) -> bool {
        let node = self.nodes.iter_mut().find(|n| n.command.name == name && n.status.is_none());
        node.is_some_and(|n| {
            let killed = n.child.kill().is_ok();
            n.status = n.child.wait().ok();
            killed
        })
    }

    /// Starts a node that has ended again, with the same arguments.
    ///
    /// # Errors
    /// [`LaunchError::Start`].
    pub fn restart(&mut self, name: &str) -> Result<bool, LaunchError> {
        let Some(i) = self.nodes.iter().position(|n| n.command.name == name && n.status.is_some())
        else {
            return Ok(false);
        };
        let child = self.spawn(&self.nodes[i].command)?;
        self.nodes[i].child = child;
        self.nodes[i].status = None;
        Ok(true)
    }

    /// Asks all nodes to end (SIGINT), waits up to `patience`, then kills the rest. Returns the names of
    /// those that had to be killed.
    pub fn stop(&mut self, patience: Duration) -> Vec<String> {
        for n in self.nodes.iter().filter(|n| n.status.is_none()) {
            interrupt(n.child.id());
        }
        let end = Instant::now() + patience;
        while self.nodes.iter().any(|n| n.status.is_none()) && Instant::now() < end {
            self.exited();
            std::thread::sleep(Duration::from_millis(20));
        }
        let left: Vec<String> = self
            .nodes
            .iter()
            .filter(|n| n.status.is_none())
            .map(|n| n.command.name.clone())
            .collect();
        for name in &left {
            self.kill(name);
        }
        left
    }
}

impl Drop for Launched {
    fn drop(&mut self) {
        self.stop(Duration::from_secs(3));
    }
}

#[cfg(target_os = "linux")]
fn end_with_this_thread(process: &mut Command) {
    let parent = std::process::id();
    // SAFETY: between fork and exec only system calls are made, and nothing is allocated.
    unsafe {
        process.pre_exec(move || {
            if libc::prctl(libc::PR_SET_PDEATHSIG, libc::SIGTERM) != 0 {
                return Err(std::io::Error::last_os_error());
            }
            // The parent may have gone before the call: then no signal will come.
            if libc::getppid() as u32 != parent {
                return Err(std::io::Error::from_raw_os_error(libc::ESRCH));
            }
            Ok(())
        });
    }
}

/// Other systems have no such signal.
#[cfg(not(target_os = "linux"))]
fn end_with_this_thread(_: &mut Command) {}

fn interrupt(pid: u32) {
    // SAFETY: kill() has no memory effects; the pid is of a child that has not been waited for, so it
    // cannot belong to another process.
    unsafe {
        libc::kill(pid as libc::pid_t, libc::SIGINT);
    }
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;
    use std::os::unix::process::ExitStatusExt as _;

    #[test]
    fn programs_end_with_the_thread_that_started_them() {
        let command = NodeCommand {
            name: "sleeper".into(),
            executable: "sleep".into(),
            arguments: vec!["60".into()],
            environment: Vec::new(),
        };
        let options =
            StartOptions { binaries: "/bin".into(), ..StartOptions::beside_this_program() };
        let start = move || Launched::start(&[command], options).unwrap();
        let mut launched = std::thread::spawn(start).join().unwrap();
        let end = Instant::now() + Duration::from_secs(20);
        while launched.exited().is_empty() && Instant::now() < end {
            std::thread::sleep(Duration::from_millis(10));
        }
        let status = launched.nodes[0].status.expect("ended by itself");
        assert_eq!(status.signal(), Some(libc::SIGTERM));
    }
}
