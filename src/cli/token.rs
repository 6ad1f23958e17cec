//! `plumb token`: manages the tokens for access to the daemon.

use std::path::{Path, PathBuf};

use crate::cli::{Failure, output};
use crate::config::token_file::{read_tokens, write_tokens};
use crate::http::tokens::{AccessToken, TokenRole};

/// Bytes of a token: twice the 128 bits that cannot be guessed.
const TOKEN_BYTES: usize = 32;

/// Create, list and revoke access tokens; a running daemon rereads them on SIGHUP.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    task: TokenTask,
}

#[derive(Debug, clap::Subcommand)]
enum TokenTask {
    /// Create a token and print it; the file keeps only its hash.
    Add(Add),
    /// List who has a token, and its role.
    List(List),
    /// Remove a token.
    Revoke(Revoke),
}

#[derive(Debug, clap::Args)]
struct Add {
    /// Who has it: letters, digits, `-`, `_`.
    name: String,
    /// What it allows: view (see everything), operate (run sessions and recordings, too), approve
    /// (approve and delete calibrations, too).
    #[arg(long, value_name = "ROLE", default_value = "operate", value_parser = ["view", "operate", "approve"])]
    role: String,
    /// The file: `token_file` in [server] of plumb.toml.
    #[arg(long, value_name = "FILE")]
    file: PathBuf,
}

#[derive(Debug, clap::Args)]
struct List {
    /// The file: `token_file` in [server] of plumb.toml.
    #[arg(long, value_name = "FILE")]
    file: PathBuf,
}

#[derive(Debug, clap::Args)]
struct Revoke {
    /// Who has it.
    name: String,
    /// The file: `token_file` in [server] of plumb.toml.
    #[arg(long, value_name = "FILE")]
    file: PathBuf,
}

/// Runs the command.
///
/// # Errors
/// A usage error for an invalid name; a failure for a file that cannot be read or written, a name
/// that already has a token, or one that has none.
pub fn run(args: &Args) -> Result<(), Failure> {
    match &args.task {
        TokenTask::Add(args) => add(args),
        TokenTask::List(args) => list(&args.file),
        TokenTask::Revoke(args) => revoke(args),
    }
}

fn add(args: &Add) -> Result<(), Failure> {
    let Add { name, role, file } = args;
    let is_name = |c: char| c.is_ascii_alphanumeric() || "-_".contains(c);
    if name.is_empty() || !name.chars().all(is_name) {
        let problem = format!("`{name}` is no name; use letters, digits, `-` and `_`");
        return Err(Failure::usage(problem));
    }
    let role = TokenRole::from_name(role)
        .ok_or_else(|| Failure::usage(format!("--role {role}: write view, operate or approve")))?;
    let mut tokens = if file.exists() { tokens_of(file)? } else { Vec::new() };
    if tokens.iter().any(|token| token.name == *name) {
        return Err(Failure::failed(format!(
            "{}: `{name}` has a token already; `plumb token revoke {name}` removes it",
            file.display()
        )));
    }
    let mut random = [0_u8; TOKEN_BYTES];
    getrandom::fill(&mut random)
        .map_err(|error| Failure::failed(format!("no random numbers: {error}; try again")))?;
    let token: String = random.iter().map(|byte| format!("{byte:02x}")).collect();
    tokens.push(AccessToken::new(name, role, &token));
    write(file, &tokens)?;
    output::print_line(&token)
}

fn list(file: &Path) -> Result<(), Failure> {
    tokens_of(file)?
        .iter()
        .try_for_each(|token| output::print_line(&format!("{} {}", token.name, token.role.name())))
}

fn revoke(args: &Revoke) -> Result<(), Failure> {
    let Revoke { name, file } = args;
    let mut tokens = tokens_of(file)?;
    let before = tokens.len();
    tokens.retain(|token| token.name != *name);
    if tokens.len() == before {
        let problem = format!("{}: `{name}` has no token; `plumb token list`", file.display());
        return Err(Failure::failed(problem));
    }
    write(file, &tokens)
}

fn tokens_of(file: &Path) -> Result<Vec<AccessToken>, Failure> {
    let tokens = read_tokens(file).map_err(Failure::failed)?;
    Ok(tokens.iter().cloned().collect())
}

fn write(file: &Path, tokens: &[AccessToken]) -> Result<(), Failure> {
    let mut text = String::from("# name role hash: written by `plumb token`\n");
    tokens.iter().for_each(|token| text += &format!("{token}\n"));
    write_tokens(file, &text).map_err(Failure::failed)
}
